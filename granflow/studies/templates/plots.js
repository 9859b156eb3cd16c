const NARROW = 600;  // width of a plot [px] below which plots in a row are stacked

// Plots in a row below each other: their x axes over the full width, their y axes in equal parts of the height.
function stack(layout) {
  const count = Object.keys(layout).filter((key) => key.startsWith("xaxis")).length;
  for (let k = 0; k < count; k++) {
    const number = k ? k + 1 : "", top = 1 - k / count;
    layout["xaxis" + number].domain = [0, 1];
    layout["yaxis" + number].domain = [top - 0.7 / count, top];
  }
  layout.height *= count;
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

for (const figure of document.querySelectorAll("figure.plot")) {
  const {data, layout} = JSON.parse(figure.querySelector("script").textContent), plot = figure.querySelector("div");
  const narrow = plot.clientWidth < NARROW;
  if (narrow && layout.xaxis2 && !layout.grid) stack(layout);
  if (narrow) layout.font.size = 11;
  const look = {responsive: true, displaylogo: false, showSendToCloud: false,
    displayModeBar: narrow ? false : "hover"};
  Plotly.newPlot(plot, data, structuredClone(layout), look).then(() => {
    makeRoom(plot, layout);
    plot.on("plotly_afterplot", () => makeRoom(plot, layout));
  });
}
