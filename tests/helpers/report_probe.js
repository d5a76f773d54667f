// what a page says of itself once it is drawn; then its slider is moved and its table sorted
(async () => {
  const told = {}, all = (s) => [...document.querySelectorAll(s)];
  const reached = (e) => { e.focus(); return document.activeElement === e; };
  told.width = document.documentElement.scrollWidth;
  await Promise.all(ready);
  const views = (p) => Bokeh.index.get_by_id(p.figure.id).renderer_views;
  const kindOf = (p, view) => view.model.data_source.name.slice(p.id.length + 1);
  told.plots = all("div.plot").map((p) => Object.fromEntries([...views(p).values()]
    .filter((view) => view.glyph).map((view) => [kindOf(p, view), view.glyph.data_size])));
  const tools = (p) => p.figure.toolbar.tools.map((tool) => tool.type);
  told.buttons = [...new Set(all("div.plot").flatMap(tools))];
  told.pictures = all("main img").map((i) => i.complete && i.naturalWidth > 0);
  // what a chart shows and does by hand: its numbers, and buttons instead of the mouse
  all("details").forEach((e) => { e.open = true; });
  told.focused = all("nav a, input, button, main pre, summary, .numbers").map(reached);
  const plot = document.querySelector("div.plot"), ranges = () => ["x_range", "y_range"]
    .map((name) => [plot.figure[name].start, plot.figure[name].end]);
  const press = (name) => [...plot.parentElement.querySelectorAll(".by-hand button")]
    .find((button) => button.textContent === name).click();
  told.ranges = [ranges(), ...["zoom in", "right", "up", "whole chart"].map((name) => {
    press(name);
    return ranges();
  })];
  told.points = all("div.plot").map((p) => [...sourceOf(p, "points").data.words ?? []]);
  const widths = (when) => {
    dispatchEvent(new Event(when));
    return all("div.plot").map((p) => Math.round(p.offsetWidth * (p.style.zoom || 1)));
  };
  told.widths = [widths("screen"), widths("beforeprint"), widths("afterprint")];
  const texts = (row) => [...row.cells].map((cell) => cell.textContent);
  await new Promise((done) => { setTimeout(done, 100); });
  told.numbers = all(".numbers").map((e) => [...e.querySelectorAll("tr")].map(texts));
  const input = document.querySelector(".slider input");
  if (input) {
    input.value = 0;
    input.dispatchEvent(new Event("input"));
    const chosen = sourceOf(document.querySelector("div.plot"), "lines").data.y.at(-1);
    told.slid_numbers = [...document.querySelectorAll(".numbers tbody tr")].slice(0, chosen.length)
      .map((row) => row.cells[row.cells.length - 1].textContent);
    told.slid = [document.querySelector("output").textContent, chosen];
  }
  // Chromium leaves buttons out of headers that it repeats on further pages
  const print = [...document.styleSheets[0].cssRules]
    .find((rule) => rule.media?.mediaText === "print");
  told.repeated = [...print.cssRules].filter((rule) => rule.selectorText === "th button")
    .map((rule) => rule.style.display);
  const head = document.querySelectorAll(".sortable th button")[5];
  if (head) {
    const column = () => all(".sortable tbody tr").map((row) => row.cells[5].textContent);
    told.sorted = [0, 1].map(() => { head.click(); return column(); });
    told.order = head.parentElement.getAttribute("aria-sort");
  }
  return told;
})()
