"use strict";
// charts
for (const told of document.querySelectorAll("script.told")) {
  const plot = told.previousElementSibling, { data, layout, frames } = JSON.parse(told.textContent);
  const points = plot.closest(".charts").querySelector("script.points");
  const words = points && JSON.parse(points.textContent);
  for (const curve of data) {
    if (curve.customdata) curve.text = curve.customdata.map((i) => words[i]);
    else if (curve.text) curve.text = curve.y.map(() => curve.text);  // newer plotly wants one a point
  }
  plot.frames = frames;
  Plotly.newPlot(plot, data, layout, {
    responsive: true, displaylogo: false, plotlyServerURL: "",
    // none that would send data anywhere, as newer versions have of their own accord
    modeBarButtons: [["toImage", "zoom2d", "pan2d", "zoomIn2d", "zoomOut2d", "resetScale2d"]],
  });
}
// on paper charts are as wide as their place there, whatever the window was
const resized = (width) => document.querySelectorAll("div.plot").forEach((plot) => {
  Plotly.relayout(plot, { width: width(plot), autosize: true });
});
addEventListener("beforeprint", () => resized((plot) => plot.closest(".whole") ? 1000 : 485));
addEventListener("afterprint", () => resized(() => null));
// what the mouse does in a chart, by buttons: a share of its width or height
const moves = {
  "zoom in": [0.5, 0, 0], "zoom out": [2, 0, 0], "left": [1, -0.25, 0], "right": [1, 0.25, 0],
  "up": [1, 0, 0.25], "down": [1, 0, -0.25],
};
// the text that plotly draws, of which parts are escaped
const plain = (text) => new DOMParser().parseFromString(text.replaceAll("<br>", ", "), "text/html").body.textContent;
// the numbers of a chart as rows: curves beside each other if they share their places
function rowsOf(plot) {
  const curves = plot.data.filter((curve) => curve.meta !== "aside"), [across, upwards] = ["xaxis", "yaxis"]
    .map((name) => plain(plot.layout[name].title.text) || "of");
  const places = (curve) => curve.x ?? curve.y.map((_, i) => Number((curve.x0 + i * curve.dx).toPrecision(7)));
  const name = (curve) => plain(curve.name || upwards), first = JSON.stringify(places(curves[0]));
  if (curves.every((curve) => !curve.customdata && JSON.stringify(places(curve)) === first)) {
    return [[across, ...curves.map(name)], ...places(curves[0]).map((x, i) => [x, ...curves.map((c) => c.y[i])])];
  }
  const row = (curve, x, i) => [name(curve), x, curve.y[i], ...(curve.customdata ? [plain(curve.text[i])] : [])];
  return [["curve", across, upwards, "case"].slice(0, curves.some((c) => c.customdata) ? 4 : 3),
    ...curves.flatMap((curve) => places(curve).map((x, i) => row(curve, x, i)))];
}
function tell(plot) {
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
  const plot = aside.parentElement.querySelector("div.plot"), axes = ["xaxis", "yaxis"];
  const whole = Object.fromEntries(axes.map((name) => [`${name}.range`, [...plot._fullLayout[name].range]]));
  aside.addEventListener("toggle", () => { if (aside.open) tell(plot); });
  aside.querySelector("p").addEventListener("click", (event) => {
    const move = moves[event.target.textContent];
    if (event.target.tagName !== "BUTTON") return;
    Plotly.relayout(plot, !move ? whole : Object.fromEntries(axes.map((name, number) => {
      const [a, b] = plot._fullLayout[name].range, [zoom, ...by] = move;
      const middle = 0.5 * (a + b) + by[number] * (b - a), half = 0.5 * zoom * (b - a);
      return [`${name}.range`, [middle - half, middle + half]];
    })));
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
      Plotly.restyle(plot, { y: [plot.frames[instant]] }, [plot.data.length - 1]);
      if (plot.parentElement.querySelector(".by-hand").open) tell(plot);
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
