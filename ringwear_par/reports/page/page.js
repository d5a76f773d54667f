"use strict";
// charts
for (const told of document.querySelectorAll("script.told")) {
  const plot = told.previousElementSibling, { data, layout, frames } = JSON.parse(told.textContent);
  plot.frames = frames;
  Plotly.newPlot(plot, data, layout, {
    responsive: true, displaylogo: false, plotlyServerURL: "",
    // none that would send data anywhere, as newer versions have of their own accord
    modeBarButtons: [["toImage", "zoom2d", "pan2d", "zoomIn2d", "zoomOut2d", "resetScale2d"]],
  });
}
// the slider above charts: the last curve of each is that of its instant
for (const slider of document.querySelectorAll(".slider input")) {
  const instants = JSON.parse(slider.dataset.instants), block = slider.closest(".charts");
  slider.addEventListener("input", () => {
    const instant = Number(slider.value);
    block.querySelector("output").textContent = instants[instant];
    slider.setAttribute("aria-valuetext", instants[instant]);
    for (const plot of block.querySelectorAll(".plot")) {
      if (plot.frames.length) Plotly.restyle(plot, { y: [plot.frames[instant]] }, [plot.data.length - 1]);
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
