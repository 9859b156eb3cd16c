for (const plot of document.querySelectorAll("figure.plot")) {
  const {data, layout} = JSON.parse(plot.querySelector("script").textContent);
  const look = {responsive: true, displaylogo: false, showSendToCloud: false};
  Plotly.newPlot(plot.querySelector("div"), data, layout, look);
}
