"use strict";
// Texts of the dataset enter by textContent only.
const data = JSON.parse(document.getElementById("data").textContent);
const byId = (id) => document.getElementById(id);
const demos = data.demonstrations;
const stageNumbers = Object.keys(data.stages).map(Number).sort((a, b) => a - b);
const seconds = (frames) => `${(frames / data.fps).toFixed(1)} s`;
let chosen = 0;
let frame = 0;
let shown = demos.map((_, place) => place);

function make(tag, className, text) {
  const element = document.createElement(tag);
  if (className) element.className = className;
  if (text !== undefined) element.textContent = text;
  return element;
}

// Runs are [end, label], in the order of time.
function ribbon(kind, runs, write) {
  const bar = make("div", `ribbon ${kind}`);
  let start = 0;
  for (const [end, label] of runs) {
    const run = make("i", kind === "skill" ? `run k${label}` : "");
    run.style.flexGrow = end - start;
    if (kind === "stage") run.style.setProperty("--level", stageNumbers.indexOf(label) / Math.max(1, stageNumbers.length - 1));
    if (write) {
      run.textContent = kind === "stage" ? data.stages[label] : label;
      run.title = `${kind === "stage" ? data.stages[label] : `skill ${label}`}, ${seconds(end - start)}`;
    }
    bar.append(run);
    start = end;
  }
  return bar;
}

const labelAt = (runs, at) => (runs.find(([end]) => at < end) ?? [0, null])[1];

function makeRow(demo, place) {
  const row = make("button", "row");
  row.type = "button";
  row.dataset.place = place;
  const body = make("div");
  body.style.setProperty("--length", demo.frames / longest);
  if (demo.strips.length) {
    const strip = make("img");
    strip.alt = "";
    strip.src = demo.strips[0];
    const [width, height] = data.cameras[0].size;
    strip.style.aspectRatio = `${width * data.count} / ${height}`;
    body.append(strip);
  }
  body.append(ribbon("skill", demo.skills, false));
  if (demo.stages.length) body.append(ribbon("stage", demo.stages, false));
  row.append(make("span", "", demo.number), body, make("span", "", seconds(demo.frames)));
  row.setAttribute("aria-label", `demonstration ${demo.number}`);
  row.addEventListener("focus", () => choose(place));
  row.addEventListener("click", () => choose(place));
  return row;
}

// The tree over time: later merges stand higher, nodes within one skill have its colour.
function tree(demo) {
  const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  const leaves = (demo.nodes.length + 1) / 2;
  const middle = ([start, end]) => (start + end) / 2;
  const height = (node) => (node < leaves ? 100 : 96 * (1 - (node - leaves + 1) / Math.max(1, leaves - 1)) + 2);
  svg.setAttribute("viewBox", `0 0 ${demo.frames} 100`);
  svg.setAttribute("preserveAspectRatio", "none");
  demo.nodes.forEach((node, number) => {
    const [start, end, one, other, skill] = node;
    if (one < 0) return;
    const path = document.createElementNS(svg.namespaceURI, "path");
    const [left, right, y] = [middle(demo.nodes[one]), middle(demo.nodes[other]), height(number)];
    path.setAttribute("d", `M${left} ${height(one)}V${y}H${right}V${height(other)}`);
    path.setAttribute("class", skill < 0 ? "loose" : `run k${skill}`);
    const title = document.createElementNS(svg.namespaceURI, "title");
    title.textContent = `${seconds(start)} to ${seconds(end)}`;
    path.append(title);
    svg.append(path);
  });
  return svg;
}

function drawPlot(demo) {
  const plot = byId("plot");
  const parts = demo.strips.slice(0, 1).map((source) => {
    const strip = make("img", "strip");
    strip.src = source;
    strip.alt = data.cameras[0].name;
    return strip;
  });
  if (demo.nodes.length) parts.push(make("h4", "", "Hierarchical task structure"), tree(demo));
  if (demo.segments.length) parts.push(make("h4", "", `${demo.segments.length} temporal segments`), ribbon("cut", demo.segments.map((end) => [end, 0]), false));
  parts.push(make("h4", "", "Skills"), ribbon("skill", demo.skills, true));
  if (demo.stages.length) parts.push(make("h4", "", "True stages"), ribbon("stage", demo.stages, true));
  const cursor = make("div");
  cursor.id = "cursor";
  plot.replaceChildren(...parts, cursor);
  plot.setAttribute("aria-valuemax", demo.frames - 1);
}

function showFrame(at) {
  const demo = demos[chosen];
  frame = Math.max(0, Math.min(demo.frames - 1, Math.round(at)));
  const picture = Math.min(data.count - 1, Math.floor((frame * data.count) / demo.frames));
  [...byId("frames").children].forEach((view) => {
    view.style.backgroundPosition = `${data.count > 1 ? (100 * picture) / (data.count - 1) : 0}% 0`;
  });
  byId("cursor").style.left = `${(100 * (frame + 0.5)) / demo.frames}%`;
  const skill = labelAt(demo.skills, frame);
  const stage = labelAt(demo.stages, frame);
  const chip = make("dd");
  chip.append(make("span", `chip k${skill}`, skill));
  const lines = [make("dt", "", "time"), make("dd", "", seconds(frame)), make("dt", "", "skill"), chip];
  if (stage !== null) lines.push(make("dt", "", "true stage"), make("dd", "", data.stages[stage]));
  byId("readout").replaceChildren(...lines);
  byId("plot").setAttribute("aria-valuenow", frame);
  byId("plot").setAttribute("aria-valuetext", `${seconds(frame)}, skill ${skill}`);
}

function choose(place) {
  if (place !== chosen || !byId("cursor")) {
    rows[chosen].removeAttribute("aria-current");
    chosen = place;
    const demo = demos[place];
    byId("which").textContent = `Demonstration ${demo.number}, ${seconds(demo.frames)}`;
    byId("task").textContent = demo.tasks.join("; ");
    byId("frames").replaceChildren(...demo.strips.map((source, camera) => {
      const view = make("div");
      view.title = data.cameras[camera].name;
      view.style.aspectRatio = data.cameras[camera].size.join(" / ");
      view.style.backgroundImage = `url("${source}")`;
      view.style.backgroundSize = `${100 * data.count}% 100%`;
      return view;
    }));
    drawPlot(demo);
    showFrame(0);
  }
  const [row, list] = [rows[place], byId("rows")];
  row.setAttribute("aria-current", "true");
  if (row.offsetTop < list.scrollTop) list.scrollTop = row.offsetTop;
  const below = row.offsetTop + row.offsetHeight - list.clientHeight;
  if (below > list.scrollTop) list.scrollTop = below;
}

// From one demonstration to another, among those that the list shows.
function move(steps) {
  const from = shown.indexOf(chosen);
  const to = Math.max(0, Math.min(shown.length - 1, from < 0 ? 0 : from + steps));
  choose(shown[to]);
  if (byId("rows").contains(document.activeElement)) rows[chosen].focus({ preventScroll: true });
}

function arrange() {
  const [order, task] = [byId("order").value, byId("tasks").value];
  const names = (demo) => demo.skills.map(([, label]) => String(label).padStart(4, "0")).join(" ");
  const keys = { number: (demo) => demo.number, frames: (demo) => demo.frames, skills: names }[order];
  shown = demos.map((_, place) => place).filter((place) => !task || demos[place].tasks.includes(task));
  shown.sort((a, b) => (keys(demos[a]) < keys(demos[b]) ? -1 : keys(demos[a]) > keys(demos[b]) ? 1 : a - b));
  byId("rows").replaceChildren(...shown.map((place) => rows[place]));
  choose(shown.includes(chosen) ? chosen : shown[0]);
}

function highlight(skill) {
  const off = skill === null || document.body.dataset.only === skill;
  if (off) delete document.body.dataset.only;
  else document.body.dataset.only = skill;
  for (const chip of document.querySelectorAll("nav [data-skill]")) {
    chip.setAttribute("aria-pressed", String(!off && chip.dataset.skill === skill));
  }
}

function onKey(event) {
  const inControl = event.target.matches("select, input");
  // Elsewhere on the page, arrows scroll.
  const { top, bottom } = byId("plot").getBoundingClientRect();
  const away = bottom < 0 || top > window.innerHeight;
  const step = demos[chosen].frames / data.count;
  const keys = {
    ArrowUp: () => move(-1),
    ArrowDown: () => move(1),
    Home: () => move(-demos.length),
    End: () => move(demos.length),
    ArrowLeft: () => showFrame(frame - step),
    ArrowRight: () => showFrame(frame + step),
    Escape: () => highlight(null),
  };
  if (!keys[event.key] || inControl || away || event.ctrlKey || event.metaKey || event.altKey) return;
  event.preventDefault();
  keys[event.key]();
}

const longest = Math.max(...demos.map((demo) => demo.frames));
const rows = demos.map(makeRow);
const tasks = [...new Set(demos.flatMap((demo) => demo.tasks))].sort();
for (const task of tasks) byId("tasks").append(new Option(task, task));
byId("which-task").hidden = tasks.length < 2;
const list = byId("rows").parentElement;
list.dataset.look = "pictures";
byId("look").addEventListener("change", (event) => { list.dataset.look = event.target.value; choose(chosen); });
byId("order").addEventListener("change", arrange);
byId("tasks").addEventListener("change", arrange);
byId("previous").addEventListener("click", () => move(-1));
byId("next").addEventListener("click", () => move(1));
for (const chip of document.querySelectorAll("nav [data-skill]")) chip.addEventListener("click", () => highlight(chip.dataset.skill));
for (const example of document.querySelectorAll(".example")) {
  example.addEventListener("click", () => {
    choose(Number(example.dataset.place));
    showFrame(Number(example.dataset.frame));
    byId("demonstrations").scrollIntoView();
  });
}
const point = (event) => {
  const box = byId("plot").getBoundingClientRect();
  showFrame(((event.clientX - box.left) / box.width) * demos[chosen].frames - 0.5);
};
byId("plot").addEventListener("pointermove", point);
byId("plot").addEventListener("pointerdown", point);
document.addEventListener("keydown", onKey);
arrange();
document.documentElement.dataset.ready = "true";
