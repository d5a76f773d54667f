"use strict";
const find = (id) => document.getElementById(id);
const element = (name, text = "", more = {}) => Object.assign(document.createElement(name), { textContent: text, ...more });
const page = { talk: null, n: 0, flying: false, waiting: false, values: {}, instant: 1, menu: find("menu").value, moving: false, pinned: null };

// -- what is asked for: one request at a time, the last one next, so that moves never queue up
function ask() {
  // a request at rest takes the place of one that takes long
  if (!page.talk || (page.flying && (page.moving || !page.slow))) { page.waiting = true; return; }
  page.flying = true; page.slow = false; page.waiting = false; page.n += 1; clearTimeout(page.late);
  const { n, values, instant, menu, moving, pinned } = page;
  page.late = setTimeout(() => { page.slow = true; say("Computing \u2026", true); find("progress").hidden = false; if (page.waiting && !page.moving) ask(); }, 400);
  page.talk.request = JSON.stringify({ n, values, instant, menu, moving, pinned });
}
function order(what) { page.talk.order = JSON.stringify({ order: what, at: performance.now() }); }
// the next is computed while figures are painted
function land() {
  clearTimeout(page.late);
  page.flying = false;
  if (page.waiting) { ask(); return; }
  find("progress").hidden = true;
  find("bar").removeAttribute("value");
  rest();
}
let resting = 0;
// said only once sliders rest, for those who listen to the page
function rest() {
  clearTimeout(resting);
  resting = setTimeout(() => {
    if (page.flying) return;
    say(page.words ?? "");
  }, 300);
}
function say(words, busy = false) {
  const status = find("status");
  if (status.textContent !== words) status.textContent = words;
  status.classList.toggle("busy", busy);
}

// -- numbers at rest: those before are undone one by one, and the address keeps the present ones
const start = { menu: page.menu };
let settled = "{}", before = [];
function settle() {
  const now = JSON.stringify(page.values);
  if (now !== settled) { before.push(settled); settled = now; }
  keep();
}
function keep() {
  const words = new URLSearchParams(page.values);
  if (page.menu !== start.menu) words.append("chart", page.menu);
  if (page.pinned) words.append("pinned", new URLSearchParams(page.pinned));
  find("undo").disabled = !before.length;
  history.replaceState(null, "", `${words}` ? `#${words}` : location.pathname);
}
function recall() {
  const words = new URLSearchParams(location.hash.slice(1)), chart = words.get("chart"), pinned = words.get("pinned");
  words.delete("chart"); words.delete("pinned");
  page.values = Object.fromEntries(words);
  page.pinned = pinned === null ? null : Object.fromEntries(new URLSearchParams(pinned));
  find("menu").value = chart ?? start.menu;
  if (!find("menu").value) find("menu").value = start.menu;
  page.menu = find("menu").value;
  settled = JSON.stringify(page.values);
  change();
}
// other numbers than those that the sliders show
function change() {
  page.moving = false; page.forced = true;
  for (const [name, text] of Object.entries(page.values)) if (controls.has(name)) controls.get(name).box.value = text;
  find("pin").textContent = page.pinned ? "Unpin" : "Pin";
  keep(); ask();
}
function undo() { if (before.length) { settled = before.pop(); page.values = JSON.parse(settled); change(); } }
find("undo").addEventListener("click", undo);
find("pin").addEventListener("click", () => { page.pinned = page.pinned ? null : { ...page.values }; change(); });
find("stop").addEventListener("click", () => order("stop"));
find("report").addEventListener("click", () => { say("Making the report \u2026", true); order("report"); });
document.addEventListener("keydown", (event) => {
  if ((event.ctrlKey || event.metaKey) && event.key === "z" && !document.activeElement.matches("input[type=text]")) { event.preventDefault(); undo(); }
});
addEventListener("hashchange", recall);

// -- controls
const controls = new Map();
for (const row of document.querySelectorAll(".control")) {
  const [range, box] = row.querySelectorAll("input"), { name, unit } = row.dataset;
  const log = "log" in row.dataset, whole = "whole" in row.dataset, assembles = "assembles" in row.dataset;
  const control = { row, range, box, log, fault: row.querySelector(".fault") };
  controls.set(name, control);
  control.place = ({ text, value, low, high, step }, force) => {
    if (force || document.activeElement !== box) box.value = text;
    if (!force && control.held) return;
    const of = (v) => log ? Math.log10(Math.max(v, Number.MIN_VALUE)) : v;
    Object.assign(range, { min: of(low), max: of(high), step });
    range.value = of(value);
    range.setAttribute("aria-valuetext", `${text} ${unit}`.trim());
  };
  control.place({ text: box.value, value: Number(range.getAttribute("value")), low: Number(range.min), high: Number(range.max), step: Number(range.step) }, true);
  const slid = () => {
    let text = range.value;
    if (log) text = String(Number((10 ** Number(range.value)).toPrecision(3)));
    if (whole) text = String(Math.round(Number(text)));
    box.value = text;
    range.setAttribute("aria-valuetext", `${text} ${unit}`.trim());
    return text;
  };
  const set = (text, moving) => { page.values = { ...page.values, [name]: text }; page.moving = moving; if (!moving) settle(); ask(); };
  range.addEventListener("input", () => {
    control.held = true;
    const text = slid();
    if (assembles) say("Let go to assemble the bodies anew.", true); else set(text, true);
  });
  range.addEventListener("change", () => { control.held = false; set(slid(), false); });
  box.addEventListener("change", () => set(box.value.trim(), false));
}
find("reset").addEventListener("click", () => { page.values = {}; settle(); change(); });
find("instant").addEventListener("input", (event) => { page.instant = Number(event.target.value); ask(); });
find("menu").addEventListener("change", (event) => { page.menu = event.target.value; keep(); ask(); });

// -- what is told
function hear(told) {
  if (told.progress !== undefined) {
    say(`Computing \u2026 ${Math.round(100 * told.progress)} % of the time`, true);
    find("progress").hidden = false; find("bar").value = told.progress;
    return;
  }
  if (told.report !== undefined) { save(told.report, "text/html", "report.html"); say("The report is saved as report.html."); return; }
  if (told.assembling) { say("Assembling the bodies \u2026", true); return; }
  const faults = told.faults ?? [], answered = told.n === page.n;
  const rested = !page.waiting && (answered || !page.flying);
  if (answered && page.flying) land(); else if (!page.flying) rest();
  page.drawn = (page.drawn ?? 0) + 1;
  if (told.faults) {
    const list = faults.map((text) => element("p", text, { className: "warning" }));
    if (faults.length) list.push(element("p", "The figures are of the last numbers that could be computed.", { className: "note" }));
    find("faults").replaceChildren(...list);
    find("figures").classList.toggle("old", faults.length > 0);
    for (const [name, { row, box, fault }] of controls) {
      const words = told.wrong[name];
      row.classList.toggle("wrong", Boolean(words));
      box.setAttribute("aria-invalid", Boolean(words));
      fault.hidden = !words; fault.textContent = words ?? "";
    }
  }
  if (told.controls) {
    for (const [name, state] of Object.entries(told.controls)) if (rested) controls.get(name)?.place(state, page.forced);
    if (rested) page.forced = false;
    find("doubts").replaceChildren(...told.doubts.map((text) => element("li", text)));
    find("doubts").hidden = !told.doubts.length;
    find("report").disabled = false;
    head(find("answers"), ["at the end", "now", ...told.compared]);
    fill(find("answers").tBodies[0], told.answers.map(([label, value, unit, ...others]) => [unit ? `${label} (${unit})` : label, value, ...others]));
    head(find("numbers"), ["quantity", "now", "unit", ...told.compared]);
    fill(find("numbers").tBodies[0], told.numbers);
    find("summary").textContent = told.summary;
    if (told.rig) find("rig").src = told.rig;
    find("case").textContent = told.case;
    find("chosen").textContent = told.chosen;
    find("instant").setAttribute("aria-valuetext", told.chosen);
    draw(told.charts);
    page.words = `The whole history, computed in ${Math.round(1000 * told.seconds)} ms.`;
  }
  if (faults.length) page.words = "Not computed:";
  if (told.laid) lay(told);
}
// nothing of this is news to the server; who has zoomed in stays there
const ends = new Map();
function draw(charts) {
  const doc = page.talk.document, quietly = { sync: false };
  for (const [name, { sources, x, y, ranges, note }] of Object.entries(charts)) {
    const plot = doc.get_model_by_name(name);
    for (const [kind, data] of Object.entries(sources)) doc.get_model_by_name(`${name}-${kind}`).setv({ data }, quietly);
    plot.below[0].setv({ axis_label: x }, quietly);
    plot.left[0].setv({ axis_label: y }, quietly);
    [plot.x_range, plot.y_range].forEach((axis, i) => {
      const [start, end] = ranges[i], before = ends.get(axis);
      const zoomed = before && (axis.start !== before[0] || axis.end !== before[1]);
      axis.setv({ reset_start: start, reset_end: end, ...(zoomed ? {} : { start, end }) }, quietly);
      ends.set(axis, ranges[i]);
    });
    find(`${name}-note`).textContent = note ? `(${note})` : "";
  }
}
function head(table, names) {
  table.tHead.replaceChildren(element("tr"));
  table.tHead.rows[0].append(...names.map((text) => element("th", text, { scope: "col" })));
}
function fill(body, rows) {
  body.replaceChildren(...rows.map((cells) => {
    const row = element("tr");
    row.append(...cells.map((text, i) => i ? element("td", text) : element("th", text, { scope: "row" })));
    return row;
  }));
}

// -- measurements
function lay({ laid, laid_fault }) {
  const told = JSON.stringify([laid, laid_fault]);
  if (told === page.laid) return;  // whoever is in a menu stays there
  const same = page.laid && JSON.stringify(JSON.parse(page.laid)[0].map((c) => [c.number, c.quantity])) === JSON.stringify(laid.map((c) => [c.number, c.quantity]));
  page.laid = told;
  find("laid").hidden = !laid.length;
  find("laid-fault").hidden = !laid_fault;
  find("laid-fault").textContent = laid_fault;
  const body = find("laid").tBodies[0];
  if (same) { laid.forEach((column, i) => { body.rows[i].cells[4].textContent = column.off; }); return; }
  body.replaceChildren(...laid.map((column) => {
    const row = element("tr"), menu = element("select", "", { ariaLabel: `${column.column} is` }), remove = element("button", "Remove", { type: "button", ariaLabel: `Remove ${column.column}` });
    menu.append(...column.choices.map((name) => element("option", name, { value: name, selected: name === column.quantity })));
    menu.addEventListener("change", () => give({ number: column.number, quantity: menu.value }));
    remove.addEventListener("click", () => give({ number: column.number, remove: true }));
    row.append(element("th", `${column.column} (${column.file})`, { scope: "row" }), ...["", column.unit, String(column.readings), column.off, ""].map((text) => element("td", text)));
    row.cells[1].append(menu); row.cells[5].append(remove);
    return row;
  }));
  const over = laid.find((column) => !column.choices[0].startsWith("profile") && column.quantity !== "penetration");
  const wanted = over && { approach: "approach", torque: "torque" }[over.quantity] || over && "volume";
  if (wanted && find("menu").value !== wanted) { find("menu").value = page.menu = wanted; ask(); }
}
function give(what) { page.talk.table = JSON.stringify({ ...what, at: performance.now() }); }
async function take(files) {
  for (const file of files) {
    if (file.size > Number(find("file").dataset.largest)) {
      find("laid-fault").hidden = false;
      find("laid-fault").textContent = `${file.name}: has ${file.size} bytes; must have at most ${find("file").dataset.largest}`;
      continue;
    }
    const bytes = new Uint8Array(await file.arrayBuffer());
    let text = "";
    for (let i = 0; i < bytes.length; i += 32768) text += String.fromCharCode(...bytes.subarray(i, i + 32768));
    give({ name: file.name, content: btoa(text) });
  }
}
find("file").addEventListener("change", async (event) => { await take([...event.target.files]); event.target.value = ""; });
document.addEventListener("dragover", (event) => { event.preventDefault(); document.body.classList.add("over"); });
document.addEventListener("dragleave", (event) => { if (!event.relatedTarget) document.body.classList.remove("over"); });
document.addEventListener("drop", (event) => {
  event.preventDefault(); document.body.classList.remove("over");
  take([...event.dataTransfer.files]);
});

// -- the case file to take home
find("copy").addEventListener("click", async () => {
  try {
    await navigator.clipboard.writeText(find("case").textContent);
    find("copied").textContent = "Copied.";
  } catch {
    getSelection().selectAllChildren(find("case"));
    find("copied").textContent = "Selected; copy it with Ctrl-C.";
  }
  setTimeout(() => { find("copied").textContent = ""; }, 4000);
});
function save(text, type, name) {
  const address = URL.createObjectURL(new Blob([text], { type }));
  element("a", "", { href: address, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(address), 10000);
}
find("download").addEventListener("click", () => save(find("case").textContent, "application/toml", "explored.toml"));

// -- the connection
const waiting = setInterval(() => {
  const doc = window.Bokeh?.documents[0], talk = doc?.get_model_by_name("talk");
  if (!talk) return;
  clearInterval(waiting);
  page.talk = talk;
  talk.properties.answer.change.connect(() => hear(JSON.parse(talk.answer)));
  doc.on_event("connection_lost", () => {
    find("faults").replaceChildren(element("p", "The connection is lost: ringwear explore has ended, or this page slept. If it still runs, load the page again.", { className: "warning" }));
  });
  if (talk.answer) hear(JSON.parse(talk.answer));
  recall();  // nothing is computed for a page without a connection
}, 50);
