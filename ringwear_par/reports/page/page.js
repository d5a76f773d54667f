"use strict";
// charts: each is a figure of bokeh, whose sources are named by their kinds of marks
Bokeh.set_log_level("error");
// twice as fine as some screens, for paper
Object.defineProperty(window, "devicePixelRatio", { value: Math.max(2, devicePixelRatio) });
const sourceOf = (plot, kind) => plot.figure.document.get_model_by_name(`${plot.id}-${kind}`);
const ready = [...document.querySelectorAll("script.drawing")].map(async (drawing) => {
  const plot = drawing.previousElementSibling, { item, frames } = JSON.parse(drawing.textContent);
  const views = await Bokeh.embed.embed_item(item, plot.id);
  plot.frames = frames;
  plot.figure = views.roots[0].model;
  plot.whole = axes.map((name) => [plot.figure[name].start, plot.figure[name].end]);
});
const axes = ["x_range", "y_range"];
function change(source, columns) {
  source.data = { ...source.data, ...columns };
}
// on paper charts are as wide as their place there, whatever the window was
addEventListener("beforeprint", () => document.querySelectorAll("div.plot").forEach((plot) => {
  const width = plot.offsetWidth;
  plot.style.width = `${width}px`;
  plot.style.zoom = (plot.closest(".whole") ? 680 : 330) / width;
}));
addEventListener("afterprint", () => document.querySelectorAll("div.plot").forEach((plot) => {
  plot.style.width = plot.style.zoom = "";
}));
// what the mouse does in a chart, by buttons: a share of its width or height
const moves = {
  "zoom in": [0.5, 0, 0], "zoom out": [2, 0, 0], "left": [1, -0.25, 0], "right": [1, 0.25, 0],
  "up": [1, 0, 0.25], "down": [1, 0, -0.25],
};
const labelOf = (axis) => axis.axis_label?.text ?? axis.axis_label ?? "";
// the numbers of a chart as rows: curves beside each other if they share their places
function rowsOf(plot) {
  const [across, upwards] = [plot.figure.below[0], plot.figure.left[0]].map((axis) => labelOf(axis) || "of");
  const curves = [], number = (value) => Number.isFinite(value) ? Number(value.toPrecision(7)) : null;
  for (const kind of ["ends", "lines"]) {
    const { x, y, name: names, stepped } = sourceOf(plot, kind).data;
    Array.from(names, (name, i) => {  // of steps their ends
      const of = (values) => Array.from(values[i], number).filter((_, j) => !stepped[i] || j % 2);
      curves.push({ name, x: of(x), y: of(y) });
    });
  }
  const { x, y, label } = sourceOf(plot, "points").data, bars = sourceOf(plot, "bars").data;
  for (const name of new Set(label)) {
    const rows = Array.from(label, (_, i) => i).filter((i) => label[i] === name);
    curves.push({ name, x: rows.map((i) => number(x[i])), y: rows.map((i) => number(y[i])) });
  }
  const keys = plot.figure.left[0].major_label_overrides;
  for (const name of new Set(bars.label)) {
    const rows = Array.from(bars.label, (_, i) => i).filter((i) => bars.label[i] === name);
    const key = (word) => word?.text ?? word;
    curves.push({ name, x: rows.map((i) => number(bars.right[i])), y: rows.map((_, i) => key(keys.get(i))) });
  }
  const first = JSON.stringify(curves[0].x);
  if (curves.every((curve) => JSON.stringify(curve.x) === first)) {
    return [[across, ...curves.map((curve) => curve.name || upwards)],
      ...curves[0].x.map((value, i) => [value, ...curves.map((curve) => curve.y[i])])];
  }
  return [["curve", across, upwards], ...curves.flatMap((curve) =>
    curve.x.map((value, i) => [curve.name || upwards, value, curve.y[i]]))];
}
function tabulate(plot) {
  const table = document.createElement("table"), rows = rowsOf(plot);
  table.createCaption().textContent = plot.parentElement.querySelector("figcaption").textContent;
  rows.forEach((row, number) => {
    const to = (number ? table.tBodies[0] ?? table.createTBody() : table.createTHead()).insertRow();
    row.forEach((value, column) => {
      const cell = document.createElement(number && column ? "td" : "th");
      if (cell.tagName === "TH") cell.scope = number ? "row" : "col";
      cell.textContent = value ?? "";
      to.append(cell);
    });
  });
  plot.parentElement.querySelector(".numbers").replaceChildren(table);
}
for (const aside of document.querySelectorAll(".by-hand")) {
  const plot = aside.parentElement.querySelector("div.plot");
  aside.addEventListener("toggle", () => { if (aside.open) tabulate(plot); });
  aside.querySelector("p").addEventListener("click", (event) => {
    const move = moves[event.target.textContent];
    if (event.target.tagName !== "BUTTON") return;
    axes.forEach((name, i) => {
      const range = plot.figure[name], log = plot.figure[`${"xy"[i]}_scale`].type === "LogScale";
      const [into, outOf] = log ? [Math.log10, (v) => 10 ** v] : [Number, Number];
      const [a, b] = [range.start, range.end].map(into), [zoom, ...by] = move ?? [];
      const middle = 0.5 * (a + b) + by[i] * (b - a), half = 0.5 * zoom * (b - a);
      [range.start, range.end] = move ? [middle - half, middle + half].map(outOf) : plot.whole[i];
    });
  });
}
// the slider above charts: the last curve of each is that of its instant
for (const slider of document.querySelectorAll(".slider input")) {
  const instants = JSON.parse(slider.dataset.instants), block = slider.closest(".charts");
  slider.addEventListener("input", () => {
    const instant = Number(slider.value);
    block.querySelector("output").textContent = instants[instant];
    slider.setAttribute("aria-valuetext", instants[instant]);
    for (const plot of block.querySelectorAll("div.plot")) {
      if (!plot.frames.length) continue;
      const frame = plot.frames[instant], lines = sourceOf(plot, "lines");
      change(lines, { y: [...lines.data.y.slice(0, -1), frame] });
      change(sourceOf(plot, "dots"), { y: frame });
      if (plot.parentElement.querySelector(".by-hand").open) tabulate(plot);
    }
  });
}
// tables sorted by a column: numbers as such, texts behind them
for (const table of document.querySelectorAll("table.sortable")) {
  const heads = [...table.tHead.rows[0].cells], body = table.tBodies[0];
  const order = new Intl.Collator("en-GB", { numeric: true }).compare;
  heads.forEach((head, column) => head.firstElementChild.addEventListener("click", () => {
    const up = head.getAttribute("aria-sort") !== "ascending";
    const value = (row) => row.cells[column].textContent;
    const number = (text) => text === "" ? NaN : Number(text);
    const rows = [...body.rows].sort((one, other) => {
      const [a, b] = [value(one), value(other)], [x, y] = [number(a), number(b)];
      if (Number.isNaN(x) !== Number.isNaN(y)) return Number.isNaN(x) ? 1 : -1;
      return (up ? 1 : -1) * (Number.isNaN(x) ? order(a, b) : x - y);
    });
    heads.forEach((other) => other.removeAttribute("aria-sort"));
    head.setAttribute("aria-sort", up ? "ascending" : "descending");
    body.append(...rows);
  }));
}
