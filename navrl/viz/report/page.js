"use strict";
// Figures into their places, and tables that sort by a click on a heading.

const CONFIG = {
  responsive: true, displaylogo: false,
  modeBarButtonsToRemove: ["select2d", "lasso2d", "zoomIn2d", "zoomOut2d", "autoScale2d"],
};

const FIGURES = JSON.parse(document.getElementById("figures").textContent);

const openEpisode = (number) =>
  document.dispatchEvent(new CustomEvent("openepisode", { detail: number }));

/** Draw a figure; a click on a recorded episode opens it. One that is folded away waits. */
function drawFigure(place) {
  const figure = FIGURES[place.id];
  if (place.data || place.closest("details:not([open])")) return;
  Plotly.newPlot(place, figure.data, figure.layout, CONFIG).then(() =>
    place.on("plotly_click", ({ points }) => {
      if (Number.isInteger(points[0].customdata) && points[0].data.type === "heatmap") {
        openEpisode(points[0].customdata);
      }
    }));
}

const drawFigures = (root) => root.querySelectorAll("figure .plot").forEach(drawFigure);

drawFigures(document);
for (const folded of document.querySelectorAll("details")) {
  folded.addEventListener("toggle", () => drawFigures(folded));
}
for (const row of document.querySelectorAll("tr.opens")) {
  row.addEventListener("click", (event) => {
    event.preventDefault(); // the link is for the keyboard
    openEpisode(Number(row.dataset.episode));
  });
}

function sortValue(row, column) {
  const cell = row.cells[column];
  if (cell.dataset.value === undefined) return cell.textContent;
  return cell.dataset.value === "" ? null : Number(cell.dataset.value);
}

function compareValues(a, b) {
  return typeof a === "string" ? a.localeCompare(b) : a - b;
}

function sortTable(table, column) {
  const headings = [...table.tHead.rows[0].cells];
  const descending = headings[column].getAttribute("aria-sort") === "ascending";
  headings.forEach((heading) => heading.removeAttribute("aria-sort"));
  headings[column].setAttribute("aria-sort", descending ? "descending" : "ascending");
  const rows = [...table.tBodies[0].rows];
  rows.sort((first, second) => {
    const a = sortValue(first, column);
    const b = sortValue(second, column);
    if (a === null || b === null) return (a === null) - (b === null); // not known: last
    return descending ? compareValues(b, a) : compareValues(a, b);
  });
  table.tBodies[0].append(...rows);
}

for (const table of document.querySelectorAll("table.sortable")) {
  [...table.tHead.rows[0].cells].forEach((heading, column) =>
    heading.querySelector("button").addEventListener("click", () => sortTable(table, column))
  );
}
