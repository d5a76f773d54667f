"""Faults of physics, statistics and storage, planted one at a time, and the tests that see them.

    python tests/planted_faults.py [--list] [--check] [NAME ...]

Each fault replaces a text that occurs once in the package, in a copy of the checkout, and the tests
named beside it, the cheapest that see it, have to fail there. Exit status 1 if one does not, or if
a text or a test is gone. Whoever deletes or rewrites a test names another one that sees its faults;
whoever rewrites code plants the fault in the new code.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
#: s, for the tests of one fault; compilation included
TIME_OUT = 300.0
#: status of pytest where tests ran and some failed
FAILED = 1


class Fault(NamedTuple):
    """A planted fault: a file of the package, a text in it that another one replaces, and tests."""

    name: str
    file: str
    old: str
    new: str
    tests: str


FAULTS = [
    # elasticity: kernels, quadrature, assembly, condensation, stress
    Fault("ring kernel", "elasticity/_rings.h", "(3.0 - 4.0 * nu)", "(3.0 - 3.9 * nu)",
          "elasticity/test_kernels.py::test_kernels_are_the_integrated_tensors"),
    Fault("moments near the axis", "elasticity/_rings.h", "0.0061558297", "0.0061558397",
          "elasticity/test_kernels.py::test_kernels_are_the_integrated_tensors"),
    Fault("singular quadrature", "elasticity/bem/quadrature.py", "_SINGULAR_POWER = 5",
          "_SINGULAR_POWER = 1", "elasticity/test_quadrature.py"),
    Fault("traction of layers", "elasticity/bem/systems.py", ", traction) / zone.material.young",
          ", traction)",
          "elasticity/test_layers.py::test_a_very_thin_film_is_a_winkler_foundation"),
    Fault("compliance on a slope", "elasticity/bem/body.py", "slope[:, None] * radial - axial",
          "-slope[:, None] * radial - axial",
          "elasticity/test_slopes.py::test_cones_are_reciprocal_and_balance"),
    Fault("moduli exchanged", "contact/problem.py", "np.tensordot(softness, self.units[pair], 1)",
          "np.tensordot(softness[::-1], self.units[pair], 1)",
          "elasticity/test_pair.py::test_compliances_of_both_bodies_add_up"),
    Fault("Poisson's ratio is not in the key", "elasticity/mesh.py",
          "*((body.section, body.grip, body.relative)", "*((body.section, body.grip)",
          "elasticity/test_pair.py::test_the_key_tells_what_a_pair_depends_on"),
    Fault("default grading", "elasticity/mesh.py", "    grading: float = 2.5",
          "    grading: float = 1.5", "elasticity/test_default_mesh.py"),
    Fault("stress kernel", "elasticity/_rings.h",
          "3.0 * integral(square, re5)", "2.9 * integral(square, re5)",
          "elasticity/test_kernels.py"),
    Fault("the upper body's place", "elasticity/stress/recovery.py",
          "displacement[:, 1] -= approach", "displacement[:, 1] += approach",
          "elasticity/test_fields.py::test_equilibrium_and_bodies_that_meet"),
    # contact
    Fault("residual is always 0", "contact/problem.py", "np.divide(miss, largest,",
          "np.divide(0.0 * miss, largest,", "contact/test_contact.py -k springs"),
    Fault("coarse contacts in blocks", "contact/block.py", "relative: float = 1e-4",
          "relative: float = 1e-2", "studies/test_many.py -k single"),
    Fault("gap forgets part of the wear", "history/block.py", "self.gap + total(wear)",
          "self.gap + 0.99 * total(wear)",
          "verification/test_rings.py::test_exact_in_time_is_what_short_steps_come_to"),
    # laws of wear
    Fault("threshold law without friction", "wear/laws.py", "rise = (k * at.friction) * at.speed",
          "rise = k * at.speed",
          "wear/test_laws.py::test_rates_and_slopes_are_those_of_the_formula"),
    Fault("Archard's volume per energy", "cases/law.py", "return k / low if", "return k if",
          "wear/test_laws.py::test_worn_volume_by_energy"),
    Fault("derivative by the input before", "functions/function.py",
          "states[:, 1 + j] - states[:, 0]", "states[:, max(j, 1)] - states[:, 0]",
          "functions/test_derivatives.py"),
    Fault("running in twice as fast", "wear/laws.py", "np.exp(-at.slid / distance)",
          "np.exp(-2.0 * at.slid / distance)",
          "wear/test_laws.py::test_rates_and_slopes_are_those_of_the_formula"),
    # schemes, errors, schedules, balances
    Fault("coefficients of SDIRK2", "history/schemes.py",
          "GAMMA = 1.0 - 1.0 / math.sqrt(2.0)", "GAMMA = 0.3",
          "history/test_schemes.py::test_orders"),
    Fault("estimate of the error", "history/schemes.py",
          "_START, _STAGE = 0.5 - 1.0 / (6.0 * GAMMA),",
          "_START, _STAGE = 0.45 - 1.0 / (6.0 * GAMMA),", "history/test_schemes.py -k estimated"),
    Fault("errors of elements that enter", "history/schemes.py", "_ENTRY = 0.05", "_ENTRY = 0.0",
          "history/test_adaptive.py -k crown"),
    Fault("weights of the energy", "history/schemes.py", "[0.0, 1.0 - GAMMA, GAMMA]",
          "[0.0, GAMMA, 1.0 - GAMMA]", "history/test_adaptive.py -k few_steps"),
    Fault("wear beyond an interface", "history/layers.py", "beyond * (ratio - 1.0)",
          "beyond * ratio", "history/test_wear_through.py"),
    Fault("integral of a schedule", "schedules.py", "0.5 * (ys[i] + np.interp(at, xs, ys)) *",
          "ys[i] *", "history/test_schedules.py -k integrals"),
    Fault("times of output", "history/block.py", "*case.output.times, time.end}",
          "*(0.9 * t for t in case.output.times), time.end}",
          "history/test_adaptive.py::test_steps_end_at_times_of_output"),
    Fault("torque without slope", "history/block.py", "p @ (self.line.true_area * self.line.r)",
          "p @ (self.line.area * self.line.r)",
          "history/test_sloping_faces.py::test_torque_and_energy_are_those_of_the_true_area"),
    # numbers and files of results
    Fault("mass by the body's density", "results/key_numbers.py",
          "volume * density[number], 0.0)", "volume * density[number, -1:], 0.0)",
          "results/test_layer_results.py::test_the_mass_lost_is_that_of_each_layer"),
    Fault("unit of p V", "results/recorder.py", "return 1e-3 * (of.state.pressure",
          "return 1e-6 * (of.state.pressure", "results/test_laboratory_numbers.py"),
    Fault("sliding distance of schedules", "results/recorder.py",
          "block.omega.integral(of.state.time)",
          "block.omega.at(of.state.time) * of.state.time",
          "results/test_laboratory_numbers.py"),
    Fault("masses in units", "cases/units.py", "of_mass = -3.0 if time else 3.0", "of_mass = 3.0",
          "cases/test_units.py::test_parameters_of_a_users_law_are_in_the_units_of_a_case"),
    Fault("restart forgets what is meshed", "results/files.py", "State(**state)",
          'State(**{**state, "meshed": None})', "results/test_restart.py -k meshes"),
    Fault("restart starts cold", "results/files.py", "State(**state)",
          'State(**{**state, "pressure": 0.0 * state["pressure"]})',
          "results/test_restart.py -k rows"),
    Fault("restart forgets the worst states", "results/recorder.py",
          "before.checkpoint.worst.items()", "[]", "results/test_restart.py -k doubts"),
    Fault("rows of a shorter run", "results/recorder.py",
          "rows = before.step % case.output.every == 0", "rows = before.step >= 0",
          "results/test_run.py -k lengthened"),
    Fault("edges stored backwards", "results/files.py", "else item[()]",
          'else item[::-1] if place == "line/edges" else item[()]',
          "results/test_result.py::test_saved_and_opened_it_is_the_same"),
    # sweeps
    Fault("merging permutes cases", "studies/results_file.py",
          "study.stored(name)[order]", "study.stored(name)[np.sort(order)]",
          "studies/test_sweep.py -k own_keys"),
    Fault("chunks of the block before", "studies/results_file.py",
          "slice(first, first + len(block.numbers))",
          "slice(max(first - 4, 0), max(first - 4, 0) + len(block.numbers))",
          "studies/test_sweep.py -k any_size"),
    Fault("copies of a case are moved by one", "studies/study.py",
          "name: of[numbers] for", "name: of[[n - 1 for n in numbers]] for",
          "studies/test_sweep.py -k own_keys"),
    Fault("table of the row before", "studies/ensemble.py",
          "rows = rows[np.arange(len(rows)), last]", "rows = rows[np.arange(len(rows)), last - 1]",
          "studies/test_sweep.py -k own_keys"),
    # fits, and plans of tests
    Fault("degrees of freedom", "identification/fit_result.py",
          "float(freedom.sum()) - raised", "float(freedom.sum())",
          "identification/test_fit_truths.py -k freedom"),
    Fault("points left out", "identification/emulator.py", "/ (1.0 - leverage)[:, None]", "",
          "identification/test_emulator.py"),
    Fault("boxes along axes", "identification/emulator.py", "np.cov(points.T / width).reshape",
          "(0.0 * np.cov(points.T / width)).reshape", "identification/test_emulator.py -k along"),
    Fault("priors of nuisances", "identification/nuisances.py", "        return nuisance.prior\n",
          "        return nuisance.prior[0], 2.0 * nuisance.prior[1]\n",
          "identification/test_likelihood.py -k dense"),
    Fault("random wear of one series", "identification/noise.py",
          "np.minimum.outer(depth, depth)", "np.multiply.outer(depth, depth)",
          "identification/test_likelihood.py -k random_wear"),
    Fault("volume of correlated noise", "identification/noise.py",
          "return np.log(_memory(series)[1])", "return 2.0 * np.log(_memory(series)[1])",
          "identification/test_likelihood.py -k dense"),
    Fault("nodes of a growth time", "identification/nuisances.py", "step * times)", "step)",
          "identification/test_likelihood.py -k growth_times"),
    Fault("an sd that is fitted", "identification/noise.py", "max(self.freedom, 1.0)",
          "max(self.freedom + 1.0, 1.0)", "identification/test_likelihood.py -k sd_that"),
    Fault("side of a limit", "identification/likelihood.py", "log_ndtr(self._side[at] * t)",
          "log_ndtr(-self._side[at] * t)", "identification/test_likelihood.py -k limits"),
    Fault("the material is not integrated", "identification/posterior.py",
          "volume - 0.5 * rest - 0.5 * np.log(precision)", "volume - 0.5 * rest",
          "identification/test_posterior.py -k integrated_out"),
    Fault("prior of sizes", "identification/posterior.py",
          "student_t.logpdf(self(theta) / self.scale, _DEGREES)",
          "student_t.logpdf(self(theta) / self.scale, 0.5 * _DEGREES)",
          "identification/test_posterior.py -k integrated_out"),
    Fault("points that are not weighed", "identification/sampling.py",
          "logs = prior + trial * likelihood - old", "logs = prior + trial * likelihood",
          "identification/test_sampling.py -k bent"),
    Fault("evidence", "identification/sampling.py",
          "logsumexp(logs - old) - np.log(len(logs))", "logsumexp(logs - old)",
          "identification/test_sampling.py -k integral"),
    Fault("verdicts at bounds", "identification/key_estimates.py",
          "[2.0 * tail, 1.0 - 2.0 * tail] if one", "[tail, 1.0 - tail] if one",
          "identification/test_users_units.py -k verdicts"),
    Fault("next specimen", "identification/key_estimates.py", "following = material + spread *",
          "following = material + 0.0 * spread *", "identification/test_fit.py -k specimens"),
    Fault("drift of a record", "identification/nuisances.py",
          "added = series.x / case.time.end", "added = series.x / series.x.max()",
          "identification/test_readings.py -k test_nuisances"),
    Fault("chains of draws", "identification/draws.py",
          "name: of.reshape(-1,", "name: of[::-1].reshape(-1,",
          "identification/test_fit_folder.py -k read_as"),
    Fault("information of a next test", "identification/design/information.py",
          "sd=setting.sd / np.sqrt(", "sd=2.0 * setting.sd / np.sqrt(",
          "identification/design/test_design.py"),
    Fault("next specimens", "identification/design/information.py",
          "+ alone * scatter, alone)", "+ alone / scatter, alone)",
          "identification/design/test_design.py -k closed_form"),
    # rigs, predictions, running tests
    Fault("steadiness", "measuring/analysis/steady_part.py", "float(np.sqrt(12.0))",
          "float(np.sqrt(3.0))", "measuring/test_steady_part.py"),
    Fault("Student's t", "measuring/analysis/repeats.py", "student.ppf(_LEVEL, n - 1)",
          "student.ppf(_LEVEL, 1e9)", "measuring/test_measure.py::test_repeats"),
    Fault("sum of a budget", "measuring/analysis/budget.py",
          "math.hypot(*(source.contribution for source in self.sources))",
          "sum(abs(source.contribution) for source in self.sources)",
          "measuring/test_budget.py"),
    Fault("shape of random wear", "prediction/predict.py",
          "random.gamma(shapes[noisy]) / shapes[noisy]",
          "random.gamma(2.0 * shapes[noisy]) / (2.0 * shapes[noisy])",
          "prediction/test_predict.py::test_worn_depth_is_a_gamma_process"),
    Fault("time to a depth", "prediction/prediction.py",
          "np.interp(depth, reached, time, right=np.inf)", "np.interp(depth, reached, time)",
          "prediction/test_predict.py::test_a_depth_is_reached_by_some_draws_only"),
    Fault("determinants of random wear", "identification/noise.py",
          "volume += np.log(np.diag(self._factor)).sum()", "volume += 0.0",
          "identification/test_likelihood.py -k random_wear"),
    Fault("weights of new draws", "monitoring/follower.py",
          "softmax(left * log_p)", "softmax(0.5 * left * log_p)",
          "monitoring/test_follow.py::test_a_sensor_that_leaves_few_draws"),
]  # fmt: skip


def is_planted_once(fault: Fault) -> bool:
    """Tell whether a fault's text occurs once, and say where it does not."""
    path = ROOT / "ringwear_par" / fault.file
    count = path.read_text(encoding="utf-8").count(fault.old) if path.exists() else 0
    if count != 1:
        print(f"{fault.name}: its text occurs {count} times in {fault.file}, not once")
    return count == 1


def copied(folder: Path) -> Path:
    """Return a copy of the checkout, as it is now and with its extensions, in a folder."""
    listed = subprocess.run(
        ["git", "ls-files", "-co", "--exclude-standard"], cwd=ROOT, check=True,
        capture_output=True, text=True,
    ).stdout.splitlines()  # fmt: skip
    listed += [
        str(path.relative_to(ROOT))
        for name in ("_rings.*.so", "_rows.*.so")
        for path in ROOT.glob(f"ringwear_par/**/{name}")
    ]
    copy = folder / "checkout"
    for name in listed:
        if (ROOT / name).is_file():
            (copy / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, copy / name)
    return copy


def is_caught(fault: Fault, copy: Path) -> bool:
    """Plant a fault in the copy, run its tests, take it out; tell whether they fail."""
    path = copy / "ringwear_par" / fault.file
    source, started = path.read_text(encoding="utf-8"), time.monotonic()
    environment = {
        **os.environ, "PYTHONPATH": str(copy), "OPENBLAS_NUM_THREADS": "1",
        "PYTHONDONTWRITEBYTECODE": "1",
    }  # fmt: skip
    words = [part if part.startswith("-k") or "/" not in part else f"tests/{part}"
             for part in fault.tests.split()]  # fmt: skip
    path.write_text(source.replace(fault.old, fault.new), encoding="utf-8")
    build = [sys.executable, "setup.py", "-q", "build_ext", "--inplace"] * (path.suffix != ".py")
    try:
        if build:
            subprocess.run(build, cwd=copy, env=environment, check=True, capture_output=True)
        run = subprocess.run(
            [sys.executable, "-m", "pytest", "-q", "-x", "--tb=no", *words], cwd=copy,
            env=environment, capture_output=True, text=True, timeout=TIME_OUT, check=False,
        )  # fmt: skip
        status, lines = run.returncode, [*run.stdout.splitlines(), *run.stderr.splitlines()]
    except subprocess.TimeoutExpired:
        status, lines = -1, [f"no end after {TIME_OUT:g} s"]
    finally:
        path.write_text(source, encoding="utf-8")
        if build:
            subprocess.run(build, cwd=copy, env=environment, check=True, capture_output=True)
    failures = [line for line in lines if line.startswith("FAILED")]
    said = failures[0].removeprefix("FAILED ") if failures else (lines or [""])[-1]
    caught = status == FAILED and bool(failures)
    verdict = "caught" if caught else "NOT CAUGHT"
    print(f"{verdict:10}  {fault.name:40}  {time.monotonic() - started:5.0f} s  {said}", flush=True)
    return caught


def main() -> int:
    """Run the script; return its exit status."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help="of faults; without, all of them")
    parser.add_argument("--list", action="store_true", help="names of faults, and who sees them")
    parser.add_argument("--check", action="store_true", help="only whether texts are still there")
    arguments = parser.parse_args()
    unknown = set(arguments.names) - {fault.name for fault in FAULTS}
    if unknown:
        parser.error(f"no such faults: {', '.join(sorted(unknown))}")
    faults = [f for f in FAULTS if not arguments.names or f.name in arguments.names]
    if arguments.list:
        print("\n".join(f"{fault.name:42}{fault.tests}" for fault in faults))
        return 0
    there = [is_planted_once(fault) for fault in faults]
    if arguments.check or not all(there):
        return int(not all(there))
    with tempfile.TemporaryDirectory(prefix="planted-") as folder:
        copy = copied(Path(folder))
        caught = [is_caught(fault, copy) for fault in faults]
    print(f"{sum(caught)} of {len(faults)} planted faults are caught")
    return int(not all(caught))


if __name__ == "__main__":
    sys.exit(main())
