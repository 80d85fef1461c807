"use strict";
// What the episode player draws with: colors, geometry, and the legend that names them.

const COLORS = {
  wall: "#4D4D4D", path: "#7F7F7F", goal: "#009E73", robot: "#CC79A7", people: "#E69F00",
  scan: "#000000", descriptor: "#009E73", speed: "#0072B2", turn: "#D55E00", end: "#E8000B",
};
const SPATIAL_SCALE = [[255, 255, 255], [86, 180, 233], [0, 114, 178]];
const TEMPORAL_SCALE = [[255, 241, 232], [213, 94, 0], [160, 28, 0]];
const ENTITIES = { "&": "&amp;", "<": "&lt;", ">": "&gt;", '"': "&quot;", "'": "&#39;", "%": "&#37;" };
/** Return text from a recording as HTML and plotly's templates show it: no tag, no variable. */
const literal = (text) => String(text).replace(/[&<>"'%]/g, (sign) => ENTITIES[sign]);
const element = (name) => document.getElementById(name);

function shade(scale, share) {
  const place = Math.min(Math.max(share, 0), 1) * (scale.length - 1);
  const low = Math.min(Math.floor(place), scale.length - 2);
  const mixed = scale[low].map((c, i) => Math.round(c + (place - low) * (scale[low + 1][i] - c)));
  return `rgb(${mixed.join(",")})`;
}

// --- geometry ----------------------------------------------------------------------------------

function toWorld([x, y, yaw], [px, py]) {
  const cos = Math.cos(yaw), sin = Math.sin(yaw);
  return [x + cos * px - sin * py, y + sin * px + cos * py];
}

function outlines(polygons) {
  const x = [], y = [];
  for (const polygon of polygons) {
    for (const point of [...polygon, polygon[0]]) { x.push(point[0]); y.push(point[1]); }
    x.push(null); y.push(null);
  }
  return { x, y };
}

const columns = (points) => ({ x: points.map((p) => p[0]), y: points.map((p) => p[1]) });

// --- legend -------------------------------------------------------------------------------------

const SWATCHES = {
  disc: (color) => `<circle cx="12" cy="8" r="6" fill="${color}" stroke="black"/>`,
  ring: (color) => `<circle cx="12" cy="8" r="6" fill="none" stroke="${color}" stroke-width="2.5"/>`,
  box: (color) => `<rect x="6" y="2" width="12" height="12" fill="${color}" stroke="black"/>`,
  block: (color) => `<rect x="1" y="5" width="22" height="6" fill="${color}"/>`,
  line: (color) => `<path d="M0 8H24" stroke="${color}" stroke-width="2.5"/>`,
  dashes: (color) => `<path d="M0 8H24" stroke="${color}" stroke-width="2" stroke-dasharray="6 3"/>`,
  dots: (color) => [4, 12, 20].map((x) => `<circle cx="${x}" cy="8" r="2" fill="${color}"/>`).join(""),
  arrow: (color) =>
    `<path d="M0 8H15" stroke="${color}" stroke-width="2.5"/><path d="M13 3L24 8L13 13Z" fill="${color}"/>`,
};

const sample = ([shape, color, text]) =>
  `<span class="key"><svg width="24" height="16" aria-hidden="true">${SWATCHES[shape](color)}</svg>${literal(text)}</span>`;

function scaleSample(text, scale, full) {
  const stops = [0, 0.5, 1].map((share) => shade(scale, share)).join(",");
  return `<span class="key scale">${text}: low, 0 <i style="background:linear-gradient(90deg,${stops})"></i>` +
    ` high, &ge; ${full.toFixed(2)}</span>`;
}

/** Name what the scene draws; what an episode lacks is left out. */
function drawLegend(episode) {
  const keys = [
    ["disc", COLORS.robot, "robot (bar: its heading)"], ["line", COLORS.robot, "its way"],
    ["ring", COLORS.goal, "goal"], ["dashes", COLORS.path, "global path"],
    ["box", COLORS.people, "pedestrian"], ["block", COLORS.wall, "wall or furniture"],
    ["dots", COLORS.scan, "scan"],
  ];
  if (episode.tagd) keys.push(["arrow", COLORS.descriptor, "TAGD: a cluster's motion, t-1 to t"]);
  if (episode.outcome !== "success") keys.push(["ring", COLORS.end, `the end: ${episode.ending}`]);
  const scales = [];
  if (episode.spatial) {
    scales.push(scaleSample("Spatial attention, sectors", SPATIAL_SCALE, episode.spatial.full));
  }
  if (episode.temporal) {
    scales.push(scaleSample("Temporal attention, rays to TAGDs", TEMPORAL_SCALE, episode.temporal.full));
  }
  element("legend").innerHTML = [...keys.map(sample), ...scales].join("");
}
