"use strict";
// The episode player: one step of one recording, drawn from the numbers in the page.

const QUIET = { ...CONFIG, displayModeBar: false };
const EPISODES = JSON.parse(document.getElementById("episodes").textContent);
const REWARD_COLORS = ["#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000"];
const state = { episode: 0, step: 0, timer: null };

const isShown = (layer) => document.querySelector(`.layer[value="${layer}"]`).checked;
const isHit = (episode, [x, y]) => Math.hypot(x, y) < episode.max_range - 1e-3;

// --- the scene ----------------------------------------------------------------------------------

/** Return the scan's rim in a sector, from border to border: a beam is as wide as its bin. */
function sectorRim(points, first, last) {
  const half = Math.PI / points.length;
  const inside = points.slice(first, last);
  const start = toWorld([0, 0, -half], inside[0]);
  return [start, ...inside, toWorld([0, 0, half], inside[inside.length - 1])];
}

function sectorShapes(episode, step) {
  const weights = episode.spatial.weights[step], pose = episode.pose[step];
  const points = episode.points[step];
  return weights.map((weight, i) => {
    const first = Math.round((i * points.length) / weights.length);
    const last = Math.round(((i + 1) * points.length) / weights.length);
    const rim = sectorRim(points, first, last).map((point) => toWorld(pose, point));
    const corners = [pose.slice(0, 2), ...rim].map(([x, y]) => `${x.toFixed(3)},${y.toFixed(3)}`);
    return {
      type: "path", path: `M${corners.join("L")}Z`, layer: "between", opacity: 0.8,
      fillcolor: shade(SPATIAL_SCALE, weight / episode.spatial.full),
      line: { width: 0.5, color: "white" },
    };
  });
}

function rayShapes(episode, step) {
  const weights = episode.temporal.weights[step], pose = episode.pose[step];
  return weights.map((weight, i) => {
    const share = weight / episode.temporal.full;
    const [x1, y1] = toWorld(pose, episode.tagd[step].vectors[i].slice(2));
    return {
      type: "line", x0: pose[0], y0: pose[1], x1, y1, layer: "between",
      line: { color: shade(TEMPORAL_SCALE, share), width: 0.6 + 3 * Math.min(share, 1) },
    };
  });
}

function circle([x, y], radius, line, fillcolor) {
  const box = { x0: x - radius, x1: x + radius, y0: y - radius, y1: y + radius };
  return { type: "circle", layer: "between", ...box, line, fillcolor: fillcolor || "rgba(0,0,0,0)" };
}

/** Return a ring about the robot where a lost episode ended: dotted until then, full at the end. */
function endShapes(episode, step) {
  const end = episode.action.length;
  if (episode.outcome === "success") return [];
  const line = step === end ? { color: COLORS.end, width: 4 }
    : { color: COLORS.end, width: 2, dash: "dot" };
  return [{ ...circle(episode.pose[end], 2 * episode.robot_radius, line), layer: "above" }];
}

function sceneShapes(episode, step) {
  const decided = step < episode.action.length; // after the last step nothing is decided
  const shapes = [];
  if (decided && episode.spatial && isShown("spatial")) shapes.push(...sectorShapes(episode, step));
  if (decided && episode.temporal && episode.tagd && isShown("temporal")) {
    shapes.push(...rayShapes(episode, step));
  }
  shapes.push(circle(episode.goal, episode.goal_radius, { color: COLORS.goal, width: 2 }));
  const outline = { color: "black", width: 1 };
  shapes.push(circle(episode.pose[step], episode.robot_radius, outline, COLORS.robot));
  return [...shapes, ...endShapes(episode, step)];
}

function descriptorTraces(episode, step) {
  if (!episode.tagd || !isShown("descriptors")) return [];
  const { vectors, valid } = episode.tagd[step], pose = episode.pose[step];
  const x = [], y = [], sizes = [], texts = [];
  vectors.forEach((vector, i) => {
    if (!valid[i]) return;
    const before = toWorld(pose, vector.slice(0, 2)), now = toWorld(pose, vector.slice(2));
    const moved = Math.hypot(now[0] - before[0], now[1] - before[1]);
    const weight = episode.temporal && episode.temporal.weights[step];
    const attention = weight ? `<br>temporal attention ${weight[i].toFixed(3)}` : "";
    const text = `descriptor ${i}: moved ${(100 * moved).toFixed(0)} cm${attention}`;
    x.push(before[0], now[0], null); y.push(before[1], now[1], null);
    sizes.push(0, moved > 0.02 ? 12 : 5, 0); texts.push(text, text, "");
  });
  const marker = { color: COLORS.descriptor, size: sizes, symbol: "arrow", angleref: "previous" };
  return [{
    x, y, marker, mode: "lines+markers", line: { color: COLORS.descriptor, width: 2 },
    name: "TAGD, t-1 to t", text: texts, hoverinfo: "text",
  }];
}

function sceneTraces(episode, step) {
  const pose = episode.pose[step], radius = episode.robot_radius;
  const flat = { mode: "lines", hoverinfo: "skip" };
  const traces = [
    { ...outlines(episode.walls), ...flat, fill: "toself", fillcolor: COLORS.wall,
      line: { width: 0 }, name: "walls and furniture" },
    { ...columns(episode.path), ...flat, line: { color: COLORS.path, dash: "dash", width: 1.5 },
      name: "global path" },
    { ...columns(episode.pose.slice(0, step + 1)), ...flat,
      line: { color: COLORS.robot, width: 2.5 }, name: "robot's way" },
    { ...outlines(episode.people[step]), mode: "lines", fill: "toself",
      fillcolor: COLORS.people, line: { color: "black", width: 1 }, hoveron: "fills",
      text: "pedestrian", hoverinfo: "text", name: "pedestrians" },
    ...descriptorTraces(episode, step),
  ];
  if (isShown("scan")) {
    const hits = episode.points[step].filter((point) => isHit(episode, point));
    traces.push({
      ...columns(hits.map((point) => toWorld(pose, point))), mode: "markers", name: "scan",
      marker: { color: COLORS.scan, size: 3.5 },
      text: hits.map(([x, y]) => `range ${Math.hypot(x, y).toFixed(2)} m`), hoverinfo: "text",
    });
  }
  const nose = [[0, 0], [radius, 0]].map((point) => toWorld(pose, point));
  traces.push({ ...columns(nose), ...flat, line: { color: "black", width: 3 }, showlegend: false });
  return traces;
}

function drawScene(episode, step) {
  const [[left, right], [bottom, top]] = episode.limits;
  const layout = {
    template: null, uirevision: state.episode, hovermode: "closest",
    shapes: sceneShapes(episode, step), margin: { l: 50, r: 10, t: 35, b: 45 },
    xaxis: { title: { text: "x in m" }, range: [left, right], constrain: "domain", zeroline: false },
    yaxis: { title: { text: "y in m" }, range: [bottom, top], scaleanchor: "x",
      constrain: "domain", zeroline: false },
    showlegend: false, // the page's own legend stands above
  };
  return Plotly.react("scene", sceneTraces(episode, step), layout, CONFIG).then((scene) =>
    scene.querySelectorAll(".shapelayer [data-index]").forEach((shape) => {
      // plotly leaves those of layer "between" that the step before had and this one has not
      if (Number(shape.dataset.index) >= layout.shapes.length) shape.remove();
    }));
}

// --- commands, rewards and attention ------------------------------------------------------------

const cursor = (time) => ({
  type: "line", x0: time, x1: time, yref: "paper", y0: 0, y1: 1, line: { color: "#7F7F7F" },
});

function overTime(episode, name, traces, layout) {
  const end = episode.action.length * episode.time_step_s;
  const full = {
    margin: { l: 55, r: 55, t: 25, b: 35 },
    xaxis: { title: { text: "time in s" }, range: [0, end] }, shapes: [cursor(0)], ...layout,
  };
  return Plotly.react(name, traces, full, QUIET).then((plot) => {
    plot.removeAllListeners("plotly_click");
    plot.on("plotly_click", ({ points }) => show(Math.round(points[0].x / episode.time_step_s)));
  });
}

/** Return the time of each step and of the end, so that the last command is held as well. */
function times(episode) {
  return Array.from({ length: episode.action.length + 1 }, (_, i) => +(i * episode.time_step_s).toFixed(6));
}

const held = (values) => (values.length ? [...values, values[values.length - 1]] : []);

function drawCommands(episode) {
  const x = times(episode);
  const line = (y, name, color, more) =>
    ({ x, y: held(y), name, mode: "lines", line: { shape: "hv", color }, ...more });
  const traces = [
    line(episode.action.map((a) => a[0]), "v", COLORS.speed,
      { hovertemplate: "v = %{y:.2f} m/s at %{x:.1f} s<extra></extra>" }),
    line(episode.action.map((a) => a[1]), "w", COLORS.turn,
      { yaxis: "y2", hovertemplate: "w = %{y:.2f} rad/s at %{x:.1f} s<extra></extra>" }),
  ];
  return overTime(episode, "commands", traces, {
    yaxis: { title: { text: "v in m/s" }, color: COLORS.speed, range: [-0.05, 1.05], nticks: 4 },
    yaxis2: { title: { text: "w in rad/s" }, color: COLORS.turn, overlaying: "y", side: "right",
      tickmode: "auto", nticks: 5, showgrid: false, zeroline: false },
    showlegend: false,
  });
}

function drawRewards(episode) {
  element("rewards").hidden = !Object.keys(episode.rewards).length;
  const x = times(episode);
  const traces = Object.entries(episode.rewards).map(([name, values], i) => ({
    x, y: held(values), name: literal(name), mode: "lines",
    line: { shape: "hv", color: REWARD_COLORS[i % REWARD_COLORS.length] },
    hovertemplate: `${literal(name)} %{y:.3f} at %{x:.1f} s<extra></extra>`,
  }));
  return overTime(episode, "rewards", traces, {
    yaxis: { title: { text: "reward" } }, showlegend: true,
    // two rows of names above the axes, where they hide no curve
    legend: { orientation: "h", yanchor: "bottom", y: 1.02 }, margin: { l: 55, r: 55, t: 50, b: 35 },
  });
}

function drawAttention(episode, step, name, what, scale) {
  const recorded = episode[name];
  element(name).hidden = !recorded;
  if (!recorded) return Promise.resolve();
  const weights = step < recorded.weights.length ? recorded.weights[step] : [];
  const most = Math.max(...recorded.weights.flat());
  const trace = {
    type: "bar", x: weights.map((_, i) => i), y: weights,
    marker: { color: weights.map((w) => shade(scale, 0.25 + (0.75 * w) / recorded.full)) },
    hovertemplate: `${what} %{x}: %{y:.3f}<extra></extra>`,
  };
  return Plotly.react(name, [trace], {
    margin: { l: 55, r: 55, t: 5, b: 35 }, bargap: 0.1,
    xaxis: { title: { text: `${what}, 0 ahead, counter-clockwise` }, range: [-0.7, recorded.weights[0].length - 0.3] },
    yaxis: { title: { text: name }, range: [0, most], nticks: 4 },
  }, QUIET);
}

// --- one step -----------------------------------------------------------------------------------

function readout(episode, step) {
  if (step === episode.action.length) return `The end: ${episode.ending}. Nothing more was decided.`;
  const [v, w] = episode.action[step];
  const terms = Object.entries(episode.rewards).map(([name, r]) => `${name} ${r[step].toFixed(3)}`);
  const reward = terms.length ? ` Reward: ${terms.join(", ")}.` : "";
  return `Command v = ${v.toFixed(2)} m/s, w = ${w.toFixed(2)} rad/s.${reward}`;
}

function show(step) {
  const episode = EPISODES[state.episode];
  state.step = Math.min(Math.max(step, 0), episode.action.length);
  const time = state.step * episode.time_step_s;
  element("time").value = state.step;
  element("clock").textContent = `${time.toFixed(1)} s (step ${state.step} of ${episode.action.length})`;
  element("readout").textContent = readout(episode, state.step);
  return Promise.all([
    drawScene(episode, state.step),
    Plotly.relayout("commands", { shapes: [cursor(time)] }),
    Plotly.relayout("rewards", { shapes: [cursor(time)] }),
    drawAttention(episode, state.step, "spatial", "sector", SPATIAL_SCALE),
    drawAttention(episode, state.step, "temporal", "descriptor", TEMPORAL_SCALE),
  ]);
}

async function choose(index) {
  pause();
  state.episode = index;
  const episode = EPISODES[index];
  element("episode").value = index;
  drawLegend(episode);
  element("time").max = episode.action.length;
  element("story").textContent = episode.story;
  await Promise.all([drawCommands(episode), drawRewards(episode)]);
  await show(episode.start_step);
}

function pause() {
  clearInterval(state.timer);
  state.timer = null;
  element("play").textContent = "Play";
}

function play() {
  const episode = EPISODES[state.episode];
  if (state.step >= episode.action.length) show(0);
  element("play").textContent = "Pause";
  state.timer = setInterval(() => {
    if (state.step >= EPISODES[state.episode].action.length) pause();
    else show(state.step + 1);
  }, 1000 * episode.time_step_s);
}

if (EPISODES.length) {
  EPISODES.forEach(({ name }, i) => element("episode").add(new Option(name, i)));
  element("episode").addEventListener("change", (event) => choose(Number(event.target.value)));
  element("time").addEventListener("input", (event) => show(Number(event.target.value)));
  element("play").addEventListener("click", () => (state.timer === null ? play() : pause()));
  document.querySelectorAll(".layer").forEach((layer) =>
    layer.addEventListener("change", () => show(state.step)));
  document.addEventListener("openepisode", ({ detail }) => {
    element("player").scrollIntoView();
    choose(detail);
  });
  choose(0).then(() => { document.body.dataset.ready = "true"; });
} else {
  document.body.dataset.ready = "true";
}
