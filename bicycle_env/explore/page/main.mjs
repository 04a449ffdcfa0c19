// The page: what is chosen, and what follows from it.
import { bodyOf, isChanged, nearest, PARTS, pointsOf, straight } from "./car.mjs";
import { DEGREE, ending, fromHash, moduleOf, NUMBERS, placeOf, sensible, SIDES, toHash, usualActuators, usualSpeed, WHO, whoInWords } from "./choices.mjs";
import { at, build, CHOICES, complaintOf, isUsual, LETTERS, show, SLIDERS } from "./controls.mjs";
import { data } from "./data.mjs";
import { Designs } from "./designs.mjs";
import { road } from "./drawing.mjs";
import { driver } from "./drivers.mjs";
import { dropped, policyOf } from "./files.mjs";
import { Hand } from "./hand.mjs";
import { askForPlane, computeOrbits, known, orbitsKey } from "./plane.mjs";
import { asPython } from "./python.mjs";
import { placed, Run, run, started } from "./simulation.mjs";
import { drawEigenvalues, drawHistories, drawPhase, drawResponses } from "./views.mjs";

const STYLES = { left: { color: "a", dashes: [] }, right: { color: "b", dashes: [7, 4] } };
const AS_PRESET = Object.fromEntries(Object.keys(PARTS).map((part) => [part, 100]));
const QUIET = 60; // ms without a change, after which what can wait is done
const tasks = {}; // by their modules' names
const dark = matchMedia("(prefers-color-scheme: dark)");
const designs = new Designs(data, arrived);

let address = ""; // as it was last read or written
const fromAddress = () => {
  address = location.hash;
  return fromHash(data, address || document.querySelector("nav a").hash); // of no address, the first example
};
let { chosen, complaints } = fromAddress();
let shown = null, now = 0, playing = null, plane = null, file = null, later = 0, used = new Set();

const load = async (name) => (tasks[name] ??= await import(`./${name}.mjs`));
await Promise.all([...data.tires.map((tire) => load(`task_${tire}`)), load(moduleOf(chosen))]);
const hand = new Hand(tasks.task_linear.exported_rules.control_timestep);

const preset = () => data.presets[chosen.vehicle];
const driven = () => SIDES.map((side) => ({ ...STYLES[side], ...shown[side] })).filter(({ columns }) => columns);
const byHand = () => chosen.left === "you";
const duration = () => Math.max(0, ...driven().map(({ columns }) => columns.time.at(-1)));

function compute() {
  const points = pointsOf(data, chosen), point = points[chosen.point], speed = point.metres_per_second;
  const body = bodyOf(data, chosen), place = placeOf(data, chosen), world = placed(tasks[moduleOf(chosen)], body, speed, place);
  const linear = placed(tasks.task_linear, body, speed, place);
  const before = shown;
  shown = { body, points, point, world, linear, straight: straight(body, speed) };
  shown.start = started(world, chosen.sideslip * DEGREE, chosen.yaw_rate * DEGREE).state;
  used = new Set();
  designs.forget();
  for (const side of SIDES) drive(side, before);
}

// Run a side's car. While what is designed for it is on its way it is drawn as `before`.
function drive(side, before = null) {
  const word = chosen[side];
  const design = (name) => {
    const found = designs.of(chosen, shown.point, name);
    used.add(found);
    return found;
  };
  const who = driver(word, {
    ...{ steer: chosen.steer, rear: chosen[`${side}_rear`], angle: chosen.angle * DEGREE, design },
    ...{ file: file?.parts, hand, names: data.observation_names, env_id: data.env_id },
  });
  const start = [chosen.sideslip * DEGREE, chosen.yaw_rate * DEGREE];
  const name = whoInWords(side, chosen, file?.name);
  if (who.pending && before?.[side].columns && word !== "you") shown[side] = before[side];
  else if (who.why) shown[side] = { who: name, why: who.why };
  else {
    const made = word === "you" ? new Run(shown.world, who, ...start) : run(shown.world, who, ...start);
    shown[side] = Object.assign(made, { who: name, car: shown.world.car, gain: who.gain });
  }
}

// What was asked for is there, or that there is none.
function arrived(design) {
  if (!used.has(design)) return;
  stop();
  for (const side of SIDES) drive(side, shown);
  showControls();
  drawNow();
  draw(["eigenvalues"]);
}

function showControls() {
  const python = asPython(data, chosen, shown.start, hand.steered);
  show({ data, chosen, shown, complaints, file, python, duration: duration() });
}

function sayOfPlane(words, busy = false) {
  at("asked").textContent = words;
  at("spinner").hidden = !busy;
  at("recoverable").disabled = !data.served && !known.asked.recoverable && chosen.recoverable === "on";
}

function drawRoad() {
  const { start, duration: blows } = data.gust, gust = now >= start && now < start + blows ? chosen.gust : 0;
  const cars = SIDES.map((side) => ({
    ...{ ...STYLES[side], letter: LETTERS[side], ...shown[side], shortly: WHO[chosen[side]] },
    ending: shown[side].why ? "does not drive" : ending(data, shown[side], chosen.area, true),
  }));
  road(at("road"), cars, now, chosen.area === "field" ? null : data.half_width.lane, gust);
}

function drawPlane() {
  const { flow, asked } = known, orbits = flow?.found ?? [], { width, height } = at("phase").getBoundingClientRect();
  const key = [flow?.key, orbits.length, asked.key, !!asked.portrait, !!asked.recoverable, width, height, devicePixelRatio, dark.matches].join();
  plane = drawPhase(at("phase"), { chosen, cars: driven(), orbits, asked, now, key });
}

// What is drawn, by the element in which it is.
const VIEWS = {
  road: drawRoad,
  phase: drawPlane,
  eigenvalues: () => {
    const laws = SIDES.map((side) => ({ ...STYLES[side], letter: LETTERS[side], gain: shown[side].gain }));
    at("fed_back").textContent = drawEigenvalues(at("eigenvalues"), shown, laws.filter(({ gain }) => gain !== undefined));
  },
  histories: () => drawHistories(at, driven(), Math.max(duration(), 0.1), now),
  responses: () => {
    const { phase, wrong, why } = drawResponses(at, shown.body, shown.point.metres_per_second, shown.linear);
    at("phase_words").textContent = phase;
    at("wrong_way").textContent = wrong;
    at("wrong_why").textContent = why;
  },
};
const MOVING = ["road", "phase", "histories"], stale = new Set();

function paint(names) {
  for (const name of names.filter((one) => stale.has(one))) {
    stale.delete(name);
    VIEWS[name]();
  }
}

const isSeen = (name) => {
  const { top, bottom } = at(name).getBoundingClientRect();
  return bottom > 0 && top < innerHeight;
};

// What is on the screen is drawn at once; the rest when nothing has changed for a moment, or when it is scrolled to.
function draw(names) {
  names.forEach((name) => stale.add(name));
  paint(names.filter(isSeen));
  unsettle();
  later = setTimeout(settle, QUIET);
}

function unsettle() {
  clearTimeout(later);
  delete document.documentElement.dataset.settled;
}

function settle() {
  paint(Object.keys(VIEWS));
  computeOrbits(shown, chosen, () => draw(["phase"]));
  if (location.hash === address) { // else a link was followed, and its hashchange is on its way
    history.replaceState(null, "", toHash(data, chosen));
    address = location.hash;
  }
  document.documentElement.dataset.settled = "yes";
}

function drawNow() {
  draw(MOVING);
  at("time").value = now;
  at("time_words").textContent = `${now.toFixed(2)} s`;
}

function update(wanted = {}) {
  const speed = pointsOf(data, chosen)[chosen.point].metres_per_second, isOther = Object.keys(PARTS).some((part) => part in wanted);
  chosen = sensible({ ...chosen, ...wanted });
  if (isOther && !("point" in wanted)) chosen.point = nearest(pointsOf(data, chosen), speed);
  const name = moduleOf(chosen);
  if (name in tasks) {
    refresh();
    return;
  }
  unsettle(); // what is chosen is not shown before its laws are there
  load(name).then(() => moduleOf(chosen) === name && refresh(), () => {
    complaints = ["The laws of this tire cannot be loaded: start “bicycle-env explore” again, and load this page anew."];
    chosen.relaxation_length = 0;
    refresh();
  });
}

function refresh() {
  stop();
  now = 0;
  hand.reset();
  compute();
  showControls();
  askForPlane(data, shown, chosen, sayOfPlane, () => draw(["phase"]));
  if (known.flow?.key !== orbitsKey(shown, chosen)) known.flow = null;
  drawNow();
  draw(["eigenvalues", "responses"]);
}

function choose(wanted) {
  complaints = [];
  update(wanted);
}

function play() {
  const hands = byHand() && shown.left.columns ? ["left"] : [];
  if (hands.length || now >= duration() - 1e-9) now = 0;
  if (hands.length) {
    hand.reset();
    hands.forEach((side) => drive(side));
  }
  let before = null;
  const frame = (stamp) => {
    now += before === null ? 0 : Math.min((stamp - before) / 1000, 0.1); // a page that was hidden goes on where it was
    before = stamp;
    const endings = () => hands.map((side) => ending(data, shown[side])).join(), said = endings();
    for (const side of hands) shown[side].until(now);
    const over = hands.every((side) => shown[side].over);
    if (endings() !== said) showControls();
    if (over) now = Math.min(now, duration());
    drawNow();
    if (!over || now < duration()) playing = requestAnimationFrame(frame);
    else stop();
  };
  playing = requestAnimationFrame(frame);
  at("road").scrollIntoView({ block: "nearest" });
  at("play").textContent = "Pause";
}

function stop() {
  if (playing === null) return;
  cancelAnimationFrame(playing);
  playing = null;
  hand.held.clear();
  at("play").textContent = "Play";
  if (byHand()) showControls();
}

function startAt(sideslip, yawRate) {
  const within = (name, value) => Math.min(Math.max(value, NUMBERS[name].least), NUMBERS[name].most);
  choose({
    sideslip: Number(within("sideslip", sideslip).toFixed(2)),
    yaw_rate: Number(within("yaw_rate", yawRate).toFixed(2)),
  });
}

async function takeFiles(given) {
  try {
    file = await policyOf(given);
    choose([chosen.left, chosen.right].includes("file") ? {} : { right: "file" });
  } catch (error) {
    complaints = [error.message];
    showControls();
  }
}

build(data);
at("change").open = isChanged(chosen);
at("change_actuators").open = !isUsual(data, chosen);

at("vehicle").addEventListener("change", ({ target }) => {
  const to = data.presets[target.value];
  const same = (to.critical_speed === null) === (preset().critical_speed === null) && !isChanged(chosen);
  const ratio = shown.point.metres_per_second / (preset().critical_speed ?? 1);
  choose({ ...AS_PRESET, vehicle: target.value, point: nearest(to.points, same ? ratio * (to.critical_speed ?? 1) : usualSpeed(to)) });
});
for (const name of CHOICES.slice(1)) at(name).addEventListener("change", ({ target }) => choose({ [name]: target.value }));
for (const name of SLIDERS) at(name).addEventListener("input", ({ target }) => choose({ [name]: Number(target.value) }));
at("as_preset").addEventListener("click", () => choose(AS_PRESET));
at("usual_actuators").addEventListener("click", () => choose({ ...usualActuators(data), relaxation_length: 0 }));
at("straight").addEventListener("click", () => choose({ sideslip: 0, yaw_rate: 0, area: "field" }));
at("recoverable").addEventListener("change", ({ target }) => choose({ recoverable: target.checked ? "on" : "off" }));
for (const name of ["sideslip", "yaw_rate"]) {
  at(name).addEventListener("input", ({ target }) => {
    complaints = [complaintOf(name)].filter(Boolean);
    update(complaints.length ? {} : { [name]: target.valueAsNumber });
  });
  at(name).addEventListener("blur", () => choose({}));
}
at("phase").addEventListener("click", ({ offsetX, offsetY }) => startAt(...plane.read(offsetX, offsetY)));
at("phase").addEventListener("keydown", (event) => {
  const [x, y] = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 2], ArrowDown: [0, -2] }[event.key] ?? [];
  if (x === undefined || (playing !== null && byHand())) return;
  event.preventDefault();
  startAt(chosen.sideslip + x, chosen.yaw_rate + y);
});
for (const [kind, down] of [["keydown", true], ["keyup", false]]) {
  addEventListener(kind, (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || playing === null || !byHand()) return;
    if (hand.press(event.key, down)) event.preventDefault();
  }, true);
}
for (const [id, key] of [["steer_left", "ArrowLeft"], ["steer_right", "ArrowRight"]]) {
  at(id).addEventListener("pointerdown", () => hand.press(key, true));
  for (const kind of ["pointerup", "pointerleave", "pointercancel"]) at(id).addEventListener(kind, () => hand.press(key, false));
}
addEventListener("blur", () => hand.held.clear());
at("play").addEventListener("click", () => (playing === null ? play() : stop()));
at("time").addEventListener("input", ({ target }) => {
  stop();
  now = Number(target.value);
  drawNow();
});
at("files").addEventListener("click", ({ target }) => (target.value = "")); // the same file, written anew, is a change
at("files").addEventListener("change", ({ target }) => takeFiles([...target.files]));
addEventListener("dragover", (event) => event.preventDefault());
addEventListener("drop", async (event) => {
  event.preventDefault();
  const given = await dropped(event.dataTransfer).catch(() => []);
  takeFiles(given.length ? given : [...event.dataTransfer.files]);
});
at("copy").addEventListener("click", async () => {
  try {
    await navigator.clipboard.writeText(at("python").textContent);
    at("copied").textContent = "Copied.";
  } catch {
    getSelection().selectAllChildren(at("python"));
    at("copied").textContent = "This browser does not let a page copy: the lines are selected, press Ctrl+C.";
  }
});
at("controls").addEventListener("submit", (event) => event.preventDefault());
addEventListener("hashchange", () => {
  ({ chosen, complaints } = fromAddress());
  update();
  at("time_words").scrollIntoView({ block: "nearest" }); // where Play is
});
const redraw = () => draw(Object.keys(VIEWS));
addEventListener("scroll", () => paint(Object.keys(VIEWS).filter(isSeen)), { passive: true });
addEventListener("resize", redraw);
new ResizeObserver(([{ target }]) => {
  document.documentElement.style.setProperty("--summary", `${target.offsetHeight}px`); // what it hides of a narrow screen
}).observe(at("summary"));
dark.addEventListener("change", redraw);

update();
document.documentElement.dataset.ready = "yes";
