// The page: what arrives goes to where it is shown, what the operator does goes to the service.

import { Alarms } from "./alarms.js";
import { ask } from "./ask.js";
import { Link, command, unpack } from "./link.js";
import { liveness } from "./liveness.js";
import { Picture, drawKind, markOf } from "./picture.js";
import { Readouts } from "./readouts.js";

const $ = (id) => document.getElementById(id);
const WATCH_MS = 100;
const LATENCIES = 300;
const MOVES = 4, MOVE_MS = 2000;

const readouts = new Readouts();
const picture = new Picture($("picture"));
const alarms = new Alarms((key) => tell("acknowledge", { key }, "acknowledged"));
let connected = false, frameMs = -Infinity, shown = null, mayControl = false, anchoring = false;
let waiting = null, drawing = false;
let ordered = 0, doneMs = -Infinity, moves = [];
const latencies = [];

// -- what arrives ------------------------------------------------------------------------------------------------------

const link = new Link({
  opened() {
    connected = true;
    doneMs = -Infinity; // a service that was started anew may have another clock
  },
  closed(code, reason) {
    connected = false;
    if (reason === "token") login();
    else if (reason) say(reason, true);
  },
  text(said) {
    if (said.type === "hello") hello(said);
    else if (readouts.said) told(said);
  },
  frame(buffer, number) {
    waiting = { buffer, number };
    if (!drawing) drawWaiting();
  },
});

async function drawWaiting() {
  drawing = true;
  while (waiting) {
    const { buffer, number } = waiting;
    waiting = null;
    const message = unpack(buffer);
    let bitmap = null;
    try {
      bitmap = await createImageBitmap(new Blob([message.picture], { type: "image/jpeg" }));
    } catch {
      say("a picture could not be read", true);
    }
    if (bitmap) await new Promise((done) => requestAnimationFrame(() => done(drawFrame(bitmap, message))));
    bitmap?.close();
    link.seen(number);
  }
  drawing = false;
}

function drawFrame(bitmap, { head, marks }) {
  if (!readouts.said) return;
  const beganMs = performance.now();
  picture.draw(bitmap, head, marks);
  shown = head;
  readouts.frame(head, marks, beganMs);
  frameMs = performance.now();
  makeMove();
  document.body.dataset.drawMs = (frameMs - beganMs).toFixed(1);
  if (link.clock.synced) {
    latencies.push(link.clock.now() - head.grabbed_ms);
    if (latencies.length > LATENCIES) latencies.shift();
  }
}

function hello(said) {
  mayControl = said.may_control;
  readouts.hello(said);
  document.querySelectorAll("footer button[data-do]").forEach((b) => {
    b.disabled = !mayControl && !["sound", "help"].includes(b.dataset.do);
  });
  if (!mayControl) say("This page may watch, not operate.");
  // the 3D viewer is for browsers of the service's own machine only
  $("viewer").hidden = !said.viewer_url || !["127.0.0.1", "localhost", "[::1]"].includes(location.hostname);
  if (said.viewer_url) $("viewer").href = said.viewer_url;
}

function told(state) {
  readouts.told(state);
  alarms.told(state, readouts.said.epoch_ms, mayControl);
  $("inputs").hidden = state.inputs.length < 2;
  const select = $("input");
  if ([...select.options].map((o) => o.value).join("\n") !== state.inputs.join("\n")) {
    select.replaceChildren(...state.inputs.map((name) => new Option(name, name)));
  }
  select.disabled = !mayControl;
  if (document.activeElement !== select) select.value = state.input;
  if (state.problem && state.problem !== told.problem) say(state.problem, true);
  told.problem = state.problem;
}

/** The page's own watch: it goes on when nothing arrives any more. */
setInterval(() => {
  const nowMs = performance.now();
  const l = liveness(readouts.said?.kind, readouts.state, connected, nowMs - link.lastMs, nowMs - frameMs);
  readouts.live(l, percentile(latencies.slice(-30), 0.5), link.clock.now());
  const data = document.body.dataset;
  data.latencyP50 = percentile(latencies, 0.5) ?? "";
  data.latencyP95 = percentile(latencies, 0.95) ?? "";
}, WATCH_MS);

function percentile(values, share) {
  if (!values.length) return null;
  const sorted = [...values].sort((a, b) => a - b);
  return sorted[Math.round(share * (sorted.length - 1))];
}

// -- what the operator does --------------------------------------------------------------------------------------------

let saidTimer = null;

function say(text, problem = false) {
  $("said").textContent = text;
  $("said").title = text;
  $("said").className = problem ? "problem" : "";
  clearTimeout(saidTimer);
  saidTimer = setTimeout(() => {
    $("said").textContent = "";
    $("said").className = "";
  }, problem ? 12000 : 5000);
}

const operator = () => $("operator").value.trim();

/** Have a command carried out in the operator's name; gives its answer, or throws what it says. */
async function order(name, body) {
  ordered += 1;
  try {
    const answer = await command(name, { operator: operator(), ...body });
    doneMs = answer.now_ms;
    return answer;
  } finally {
    ordered -= 1;
  }
}

/** The same, and say how it went; gives its answer, or null. */
async function tell(name, body, done) {
  try {
    const answer = await order(name, body);
    say(typeof done === "function" ? done(answer) : done);
    return answer;
  } catch (error) {
    say(error.message, true);
    return null;
  }
}

const chosen = (tube) => tube.name ?? `row ${tube.row}, column ${tube.column}`;

function chooseTube(tube) {
  tell("target", { tube: `${tube.row},${tube.column}`, generation: tube.generation, index: tube.index }, `target is ${chosen(tube)}`);
}

function askAnchor(tube) {
  setAnchoring(false);
  ask("Anchor", `Which tube is it that the picture has at row ${tube.row}, column ${tube.column}? All others get their names from it.`,
    [{ name: "name", label: "its name", value: tube.name ?? "", hint: readouts.said.naming === "line-row" ? "L83R87" : "ROW12 COL34", required: true }],
    "Anchor", async ({ name }) => {
      const done = await order("anchor", { row: tube.row, column: tube.column, name, generation: tube.generation, index: tube.index });
      say(`anchor ${done.anchor}`);
    });
}

function setAnchoring(on) {
  anchoring = on;
  document.body.classList.toggle("anchoring", on);
  document.querySelector('[data-do="anchor"]').setAttribute("aria-pressed", String(on));
  if (on) say("Click the tube whose name you know; Esc: leave");
}

/** The target as a tube of the picture; null where it is not in it. */
function targetTube() {
  if (!shown?.target) return null;
  const [row, column] = shown.target;
  return { row, column, name: shown.names?.[`${row},${column}`] ?? null, generation: shown.generation, index: shown.index };
}

const DO = {
  target() {
    ask("Target", "The tube to align to: its name, its place in the lattice (row,column), or nearest.",
      [{ name: "tube", label: "tube", value: readouts.state?.target ?? "", required: true }], "Choose", async ({ tube }) => {
        const done = await order("target", { tube });
        say(`target is ${done.target}`);
      });
  },
  nearest: () => tell("target", { tube: "nearest" }, "target is the nearest"),
  anchor: () => setAnchoring(!anchoring),
  record() {
    const on = !readouts.state?.recording?.on;
    if (on) tell("recording", { on }, (a) => `recording into ${a.folder}`);
    else ask("Stop recording", "The session ends here; what was recorded is kept.", [], "Stop recording", async () => {
      await order("recording", { on: false });
      say("recording stopped");
    });
  },
  mark() {
    ask("Mark", "Data acquisition begins or ends here: the pictures before and after it go on record.",
      [{ name: "text", label: "what", value: "acquisition", required: true, most: 200 }], "Mark", async ({ text }) => {
        const done = await order("mark", { text });
        say(`marked; evidence record ${done.number}`);
      });
  },
  verify() {
    const tube = targetTube();
    ask("Verify", "Puts the picture on record, with the tube you say it is. If you override what the picture says, give the reason.",
      [
        { name: "claim", label: "this is tube", value: tube?.name ?? "", hint: "left empty: no claim" },
        { name: "operator", label: "operator", value: operator(), most: 40 },
        { name: "reason", label: "override, because", hint: "left empty: no override", most: 500 },
      ],
      "Verify", async ({ claim, operator: by, reason }) => {
        const done = await order("verify", { claim: claim || null, operator: by, reason: reason || null });
        const seen = done.agrees === true ? "the picture agrees" : done.agrees === false ? `THE PICTURE SAYS ${done.tube_seen}` : "the picture tells no name";
        say(`evidence record ${done.number}: ${seen}`, done.agrees === false);
      });
  },
  sound() {
    const on = alarms.toggleSound();
    document.querySelector('[data-do="sound"]').setAttribute("aria-pressed", String(on));
    say(on ? "alarms sound" : "alarms are silent");
  },
  help: () => $("help").showModal(),
};

document.querySelectorAll("[data-do]").forEach((b) => {
  b.onclick = () => DO[b.dataset.do]();
});
$("input").onchange = (event) => tell("input", { name: event.target.value }, `input is ${event.target.value}`);
$("operator").value = localStorage.getItem("operator") ?? "";
$("operator").onchange = () => localStorage.setItem("operator", operator());

$("picture").onclick = (event) => {
  const tube = picture.tubeAt(event.clientX, event.clientY);
  if (!tube || !mayControl) return;
  if (anchoring) askAnchor(tube);
  else chooseTube(tube);
};

$("picture").onpointermove = (event) => {
  const tube = picture.tubeAt(event.clientX, event.clientY), box = $("stage").getBoundingClientRect();
  $("hover").hidden = !tube;
  if (!tube) return;
  $("hover").textContent = `${chosen(tube)}, ${tube.kind}`;
  $("hover").style.left = `${Math.min(event.clientX - box.left + 16, box.width - 190)}px`;
  $("hover").style.top = `${event.clientY - box.top + 16}px`;
};
$("picture").onpointerleave = () => ($("hover").hidden = true);

// -- keys --------------------------------------------------------------------------------------------------------------

const KEYS = [
  ["T", "choose the target by its name", "t", DO.target],
  ["N", "target: the tube nearest to the guide", "n", DO.nearest],
  ["← → ↑ ↓", "target: the next tube that way in the picture", null, null],
  ["A", "anchor: click the tube whose name you know", "a", DO.anchor],
  ["⇧A", "anchor the target's own name", "A", () => (targetTube() ? askAnchor(targetTube()) : say("no target in the picture", true))],
  ["K", "acknowledge the first alarm nobody has seen", "k", () => alarms.acknowledgeFirst()],
  ["⇧K", "acknowledge all alarms", "K", () => tell("acknowledge", { key: null }, "all acknowledged")],
  ["R", "start or stop recording", "r", DO.record],
  ["M", "mark the begin or end of data acquisition", "m", DO.mark],
  ["V", "verify: put the picture on record as evidence", "v", DO.verify],
  ["I", "choose the video input", "i", () => $("input").focus()],
  ["S", "sound of the alarms, on or off", "s", DO.sound],
  ["W", "open the 3D viewer", "w", () => !$("viewer").hidden && $("viewer").click()],
  ["?", "this list", "?", DO.help],
  ["Esc", "leave what was begun", "Escape", () => setAnchoring(false)],
];
const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
const WATCHING = new Set(["s", "w", "?", "Escape"]);

addEventListener("keydown", (event) => {
  // until its next picture a browser leaves the focus in a dialog that is closed
  const dialog = event.target.closest("dialog");
  const typing = dialog ? dialog.open : event.target.closest("input, select");
  if (typing || event.ctrlKey || event.altKey || event.metaKey) return;
  const key = KEYS.find((k) => k[2] === event.key), arrow = ARROWS[event.key];
  if ((key || arrow) && !mayControl && !WATCHING.has(event.key)) return;
  if (key) key[3]();
  else if (arrow) moveTarget(arrow, event.repeat);
  else return;
  event.preventDefault();
});

function moveTarget(arrow, again) {
  if (again ? !moves.length : moves.length < MOVES) moves.push({ arrow, untilMs: performance.now() + MOVE_MS });
  makeMove();
}

/** Make the next move, once the picture shows what was done before it: from there it goes on. */
function makeMove() {
  moves = moves.filter((move) => move.untilMs > performance.now());
  if (!moves.length || ordered || !(shown?.grabbed_ms > doneMs)) return;
  const tube = picture.tubeBeside(...moves.shift().arrow);
  if (tube) chooseTube(tube);
}

function describe(list, rows) {
  list.replaceChildren(
    ...rows.flatMap(([what, text]) => {
      const dt = document.createElement("dt"), dd = document.createElement("dd");
      dt.append(what);
      dd.textContent = text;
      return [dt, dd];
    }),
  );
}

function markShown(kind) {
  const canvas = document.createElement("canvas"), path = new Path2D();
  [canvas.width, canvas.height] = [34, 24];
  markOf(path, kind, 17, 12, 9, 0, 0, 9);
  drawKind(canvas.getContext("2d"), kind, path);
  return canvas;
}

describe($("keys"), KEYS.map(([key, text]) => {
  const kbd = document.createElement("kbd");
  kbd.textContent = key;
  return [kbd, text];
}));
describe($("marks"), [
  [markShown(0), "a tube measured in this picture"],
  [markShown(1), "a tube predicted from the others"],
  [markShown(2), "a plugged tube"],
  [markShown(3), "no tube where the lattice has one"],
  ["⌜ ⌟", "the target"],
  ["+", "where the probe would hit, with its outline"],
]);

// -- who may -----------------------------------------------------------------------------------------------------------

function login() {
  const given = new URLSearchParams(location.hash.slice(1)).get("token");
  history.replaceState(null, "", location.pathname); // a token is not left in the address
  const enter = async (token) => {
    await command("login", { token });
    link.reopen();
  };
  const byHand = (problem) => {
    ask("Token", "This station asks for a token: it was shown in the terminal when the service started.",
      [{ name: "token", label: "token", required: true, secret: true, most: 200 }], "Enter", ({ token }) => enter(token));
    $("askproblem").textContent = problem;
  };
  if (given) enter(given).catch((error) => byHand(error.message));
  else byHand("");
}
