"use strict";
const byId = (id) => document.getElementById(id);
const settings = JSON.parse(byId("settings").textContent);
const token = new URLSearchParams(location.search).get("token") ?? "";
const headers = { "X-Token": token };
const me = crypto.getRandomValues(new Uint32Array(2)).join("-");

function make(tag, className = "", text = "") {
  const element = document.createElement(tag);
  element.className = className;
  element.textContent = text;
  return element;
}

// What is wrong, most serious first; only that is shown.
const wrong = { link: "", focus: "" };
function say(kind, text) {
  wrong[kind] = text;
  const first = wrong.link || wrong.focus;
  byId("notice").hidden = !first;
  if (byId("notice").textContent !== first) byId("notice").textContent = first;
}

// ---- keys: all that are held are said again and again, since the robot forgets them after half a second

const held = new Map(); // what holds it, a key of the keyboard or a finger -> the key's name
let count = 0, sending = false, again = false;

async function tell() {
  if (sending) { again = true; return; }
  sending = true;
  do {
    again = false;
    const body = JSON.stringify({ page: me, number: count++, held: [...new Set(held.values())] });
    try {
      await fetch("keys", { method: "POST", headers, body, signal: AbortSignal.timeout(500) });
    } catch { letGo(); }
  } while (again);
  sending = false;
}

function hold(by, name) {
  held.set(by, name);
  tell();
}

// Without an argument: all of them.
function letGo(by) {
  const some = by === undefined ? held.size > 0 : held.has(by);
  if (by === undefined) held.clear(); else held.delete(by);
  if (some) tell();
}

setInterval(() => { if (held.size) tell(); }, 100);

const keys = [...document.querySelectorAll("[data-key]")];
const names = new Set(keys.map((key) => key.dataset.key));
const shortcuts = { Enter: "next", Backspace: "re-record" };

addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey) return letGo(); // the key is for the browser
  const name = event.key.toLowerCase();
  if (names.has(name)) {
    event.preventDefault();
    if (!event.repeat) hold(event.code || name, name);
  } else if (event.key in shortcuts && !event.repeat && !event.target.closest("#buttons")) {
    document.querySelector(`#buttons [data-name="${shortcuts[event.key]}"]`)?.click();
  }
});
addEventListener("keyup", (event) => letGo(event.code || event.key.toLowerCase()));

function focused() {
  const here = document.hasFocus() && !document.hidden;
  if (!here) letGo();
  say("focus", here ? "" : "Keys go elsewhere now. Click into this page to move the hand.");
}
addEventListener("blur", () => { letGo(); focused(); });
addEventListener("focus", focused);
addEventListener("pagehide", () => letGo());
document.addEventListener("visibilitychange", focused);

for (const key of keys) {
  const by = (event) => `finger ${event.pointerId}`;
  key.addEventListener("pointerdown", (event) => {
    event.preventDefault();
    key.setPointerCapture(event.pointerId);
    hold(by(event), key.dataset.key);
  });
  for (const kind of ["pointerup", "pointercancel", "lostpointercapture"]) {
    key.addEventListener(kind, (event) => letGo(by(event)));
  }
  key.addEventListener("contextmenu", (event) => event.preventDefault());
}

// ---- buttons

async function press(button) {
  button.disabled = true; // pressed twice, "next" would end the next episode, too
  setTimeout(() => { button.disabled = false; }, 1000);
  button.blur();
  try {
    const body = JSON.stringify({ name: button.dataset.name });
    await fetch("press", { method: "POST", headers, body, signal: AbortSignal.timeout(2000) });
  } catch { /* the stream says that the connection is lost */ }
}

function offer(wanted) {
  const present = [...byId("buttons").children].map((button) => button.dataset.name);
  if (present.join() === wanted.join()) return;
  byId("buttons").replaceChildren(...wanted.map((name) => {
    const button = make("button", "", settings.buttons[name] ?? name);
    button.type = "button";
    button.dataset.name = name;
    const shortcut = Object.keys(shortcuts).find((key) => shortcuts[key] === name);
    if (shortcut) button.append(make("kbd", "", shortcut));
    button.addEventListener("click", () => press(button));
    return button;
  }));
}

// ---- what the robot shows

const phases = { free: "Free", episode: "Recording", reset: "Next scene", paused: "Paused", correction: "Correcting" };
const written = (name) => name.replaceAll("_", " ");

function tellFacts({ facts, held: taken, pressable }) {
  byId("task").textContent = facts.task ? written(facts.task) : "Waiting for the robot";
  const phase = phases[facts.phase] ?? "";
  byId("phase").dataset.phase = facts.phase ?? "";
  if (byId("phase").textContent !== phase) byId("phase").textContent = phase;
  const told = [];
  if (facts.episodes !== undefined) told.push(`${facts.episodes} saved`);
  if (facts.seed !== undefined) told.push(`seed ${facts.seed}`);
  if (facts.steps !== undefined) told.push(`${(facts.steps / settings.fps).toFixed(1)} s`);
  if (rate()) told.push(`${rate()} frames/s`);
  byId("facts").textContent = told.join(" \u00b7 ");
  const stages = Object.entries(facts.stages ?? {});
  byId("progress").hidden = !stages.length;
  while (byId("stages").children.length > stages.length) byId("stages").lastChild.remove();
  stages.forEach(([name, done], place) => {
    const item = byId("stages").children[place] ?? byId("stages").appendChild(make("li"));
    if (item.textContent !== written(name)) item.textContent = written(name);
    item.className = done ? "done" : "";
    item.setAttribute("aria-label", `${written(name)}: ${done ? "done" : "open"}`);
  });
  byId("outcome").hidden = !facts.succeeded;
  for (const key of keys) key.classList.toggle("on", taken.includes(key.dataset.key));
  offer(pressable ? facts.buttons ?? settings.recording : []);
}

const canvases = new Map();
function canvasOf(name) {
  if (!canvases.has(name)) {
    const figure = make("figure"), canvas = make("canvas");
    figure.append(canvas, make("figcaption", "", written(name)));
    byId("cameras").append(figure);
    canvases.set(name, canvas);
  }
  return canvases.get(name);
}

async function draw(images) {
  const pictures = await Promise.all(images.map(({ jpeg }) => createImageBitmap(new Blob([jpeg], { type: "image/jpeg" }))));
  pictures.forEach((picture, place) => {
    const canvas = canvasOf(images[place].name);
    if (canvas.width !== picture.width || canvas.height !== picture.height) {
      canvas.width = picture.width;
      canvas.height = picture.height;
      canvas.style.setProperty("--shape", picture.width / picture.height);
    }
    canvas.getContext("2d").drawImage(picture, 0, 0);
    picture.close();
  });
  drawn.push(performance.now());
  document.documentElement.dataset.frames = ++frames;
}

const drawn = [];
let frames = 0;
function rate() {
  const since = performance.now() - 2000;
  while (drawn.length && drawn[0] < since) drawn.shift();
  return Math.round(drawn.length / 2);
}

// ---- the stream: messages as `feed.py` packs them; of several that wait, the newest is drawn

const text = new TextDecoder();
function parse(bytes) {
  const view = new DataView(bytes.buffer, bytes.byteOffset);
  let at = 4 + view.getUint32(0);
  const header = JSON.parse(text.decode(bytes.subarray(4, at)));
  const images = header.images.map(({ name, bytes: size }) => ({ name, jpeg: bytes.subarray(at, at += size) }));
  return { ...header, images };
}

let waiting = null, drawing = false;
async function drawNewest() {
  if (drawing) return;
  drawing = true;
  try {
    while (waiting) {
      const images = waiting;
      waiting = null;
      await draw(images);
    }
  } finally { drawing = false; }
}

function take(buffer) {
  const view = new DataView(buffer.buffer, buffer.byteOffset, buffer.byteLength);
  let at = 0, newest = null;
  while (buffer.length - at >= 4 && buffer.length - at - 4 >= view.getUint32(at)) {
    const end = at + 4 + view.getUint32(at);
    newest = parse(buffer.subarray(at + 4, end));
    if (newest.images.length) waiting = newest.images;
    at = end;
  }
  if (newest) { tellFacts(newest); drawNewest(); }
  return buffer.slice(at);
}

const SILENCE_MS = 3000; // a simulator that is loading may hold up its process for so long
async function follow() {
  const patience = new AbortController();
  let alarm;
  const heard = () => { clearTimeout(alarm); alarm = setTimeout(() => patience.abort(), SILENCE_MS); };
  try {
    heard();
    const answer = await fetch("stream", { headers, cache: "no-store", signal: patience.signal });
    if (answer.status === 403) return false;
    if (!answer.ok) throw new Error(`status ${answer.status}`);
    const reader = answer.body.getReader();
    let rest = new Uint8Array(0);
    for (;;) {
      const { done, value } = await reader.read();
      if (done) throw new Error("the stream has ended");
      heard();
      lose("");
      const joined = new Uint8Array(rest.length + value.length);
      joined.set(rest);
      joined.set(value, rest.length);
      rest = take(joined);
    }
  } catch {
    return true;
  } finally {
    clearTimeout(alarm);
  }
}

// Tells why nothing new is shown; an empty reason: it is.
function lose(reason) {
  if (wrong.link === reason) return;
  document.body.classList.toggle("lost", reason !== "");
  if (reason) {
    letGo();
    for (const key of keys) key.classList.remove("on");
  }
  say("link", reason);
}

async function main() {
  focused();
  while (await follow()) {
    lose("The connection is lost. Trying again.");
    await new Promise((done) => setTimeout(done, 500));
  }
  lose("This address has expired. Open the one that the command printed last.");
}
document.documentElement.dataset.ready = "true";
main();
