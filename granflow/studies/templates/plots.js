const NARROW = 600;  // width of a plot [px] below which plots in a row are stacked

// Plots in a row below each other: their x axes over the full width, each with the height that it has in a row.
function stack(layout) {
  const count = Object.keys(layout).filter((key) => key.startsWith("xaxis")).length, gap = 64;
  const {t, b} = layout.margin, height = layout.height - t - b, inner = count * height + (count - 1) * gap;
  for (let k = 0; k < count; k++) {
    const number = k ? k + 1 : "", top = 1 - k * (height + gap) / inner;
    layout["xaxis" + number].domain = [0, 1];
    layout["yaxis" + number].domain = [Math.max(top - height / inner, 0), top];
  }
  layout.height = inner + t + b;
}

// The legend below the title of the time axis, at its full height: the figure grows, not the plot.
function makeRoom(plot, layout) {
  const legend = plot.querySelector(".legend .bg");
  if (!legend || layout.legend?.orientation !== "h") return;
  const rows = Math.ceil(legend.getBoundingClientRect().height);
  const {t, b} = layout.margin, inner = layout.height - t - b, gap = 4;
  const room = {"height": layout.height + rows + gap, "margin.b": b + rows + gap, "legend.y": -(b + gap) / inner};
  if (plot._fullLayout.height !== room.height) Plotly.relayout(plot, room);
}

// The figure in the colors of the page; a black curve has the color of the text.
function themed({data, layout}) {
  const style = getComputedStyle(document.documentElement), color = (name) => style.getPropertyValue("--" + name).trim();
  const found = structuredClone({data, layout}), page = color("page"), text = color("text");
  Object.assign(found.layout, {paper_bgcolor: page, plot_bgcolor: page, font: {...layout.font, color: text},
    hoverlabel: {bgcolor: page, font: {color: text}}});
  for (const key of Object.keys(layout).filter((each) => /^[xy]axis/.test(each))) {
    Object.assign(found.layout[key], {linecolor: color("axis"), gridcolor: color("grid")});
  }
  (found.layout.annotations ?? []).forEach((each) => { each.font = {...each.font, color: color("faint")}; });
  (found.layout.shapes ?? []).forEach((each) => { each.line = {...each.line, color: color("faint")}; });
  for (const {line} of found.data) if (line?.color === "#000000") line.color = text;
  return found;
}

function drawPlot(figure) {
  const content = JSON.parse(figure.querySelector("script").textContent), {layout} = content;
  const plot = figure.querySelector("div"), narrow = plot.clientWidth < NARROW;
  if (narrow && layout.xaxis2?.domain) stack(layout);
  if (narrow) layout.font.size = Math.min(layout.font.size, 11);
  const look = {responsive: true, displaylogo: false, showSendToCloud: false,
    displayModeBar: narrow ? false : "hover"};
  const draw = () => {
    const {data, layout} = themed(content);
    return Plotly.react(plot, data, layout, look).then(() => makeRoom(plot, content.layout));
  };
  draw().then(() => {
    plot.on("plotly_afterplot", () => makeRoom(plot, layout));
    new ResizeObserver(() => {  // in the same frame as the page, where plotly waits for the event of the window
      if (plot.clientWidth && plot._fullLayout.width !== plot.clientWidth) Plotly.relayout(plot, {autosize: true});
    }).observe(figure);
  });
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", draw);
}

function sayWhy(figure, error) {
  figure.querySelector("div").textContent = `The plot cannot be shown: ${error.message}.`;
}

inflated(document.querySelector("#plotly").textContent).then((bytes) => {
  const script = document.createElement("script");
  script.textContent = new TextDecoder().decode(bytes);
  document.head.append(script);
  for (const figure of document.querySelectorAll("figure.plot")) {
    try {
      drawPlot(figure);
    } catch (error) {
      sayWhy(figure, error);
    }
  }
}).catch((error) => document.querySelectorAll("figure.plot").forEach((figure) => sayWhy(figure, error)));
