"""Recipes of packages ask for what pyproject.toml asks for."""

import re
import tomllib

import pytest
from paths import ROOT

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
EXTRAS = PROJECT["optional-dependencies"]
RECIPES = ROOT / "scripts" / "packaging"
#: extras that Spack's packages are new enough for
SPACK = ("fit", "report", "sensitivity", "xarray")

pytestmark = pytest.mark.serial


def wanted(*extras):
    """Return (name, least version, extra) of what is needed, and of what some extras need."""
    for extra in (None, *extras):
        for told in EXTRAS[extra] if extra else PROJECT["dependencies"]:
            name, _, least = told.partition(">=")
            yield name.lower(), least, extra


def test_what_a_package_index_shows_has_no_links_into_the_repository():
    text = (ROOT / PROJECT["readme"]["file"]).read_text("utf-8")
    assert PROJECT["readme"]["content-type"] == "text/markdown"
    assert "pip install ringwear-par" in text
    assert re.findall(r"\]\((?!https://)|<img|\{\w+\}`", text) == []


def test_spack():
    text = (RECIPES / "package.py").read_text("utf-8")
    told = {}
    for name, least, rest in re.findall(r'depends_on\("py-([\w-]+)@([\d.]+):"(.*)\)', text):
        when = re.search(r'when="\+(\w+)"', rest)
        told[name] = least, when and when[1]
    assert told.pop("setuptools")
    assert told.pop("petsc4py") == (EXTRAS["petsc"][0].partition(">=")[2], None)
    assert told == {name: (least, extra) for name, least, extra in wanted(*SPACK)}
    assert re.findall(r'variant\("(\w+)"', text) == list(SPACK)


def test_conda():
    text = (RECIPES / "recipe.yaml").read_text("utf-8")
    run, extras = text.partition("  run:")[2].split("  run_constraints:")
    told = {name.removesuffix("-base"): v for name, v in re.findall(r"- ([\w-]+) >=([\d.]+)", run)}
    assert told.pop("python") == PROJECT["requires-python"].removeprefix(">=")
    assert told.pop("petsc4py")
    assert told == {name: least for name, least, _ in wanted()}
    told |= dict(re.findall(r"- ([\w-]+) >=([\d.]+)", extras))
    own = [extra for extra in EXTRAS if extra not in ("petsc", "docs", "test")]
    assert told == {name: least for name, least, _ in wanted(*own)}


@pytest.mark.parametrize("name", ["Dockerfile", "apptainer.def"])
def test_containers_have_all_that_users_may_want(name):
    (extras,) = re.findall(r"/src\[([\w,]+)\]", (RECIPES / name).read_text("utf-8"))
    assert set(extras.split(",")) == set(EXTRAS) - {"petsc", "docs", "test"}
