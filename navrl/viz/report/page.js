"use strict";
// Figures into their places, and tables that sort by a click on a heading.

const CONFIG = { responsive: true, displaylogo: false };

for (const [name, figure] of Object.entries(
  JSON.parse(document.getElementById("figures").textContent)
)) {
  Plotly.newPlot(name, figure.data, figure.layout, CONFIG);
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
