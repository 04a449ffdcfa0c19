// The page: what is chosen, and what follows from it.
import { bodyOf, changes, eigenvalues, isChanged, nearest, PARTS, PERCENT, pointsOf, speedInWords, stabilityInWords, straight } from "./car.mjs";
import { asPython, DEGREE, ending, fromHash, NUMBERS, OTHERS, REAR, STEER, toHash, usualSpeed, WHO, whoInWords } from "./choices.mjs";
import { data } from "./data.mjs";
import { road } from "./drawing.mjs";
import { Hand } from "./hand.mjs";
import { read } from "./policy.mjs";
import { ask } from "./server.mjs";
import { driver, grid, orbit, placed, Run, run, started } from "./simulation.mjs";
import { BOX, drawEigenvalues, drawHistories, drawPhase, drawResponses } from "./views.mjs";

const at = (id) => document.getElementById(id);
const SIDES = { left: { color: "a", letter: "A", dashes: [] }, right: { color: "b", letter: "B", dashes: [7, 4] } };
const GRID = 9, SECONDS = 4, SLICE = 12; // of the orbits; ms in which nothing else is done
const QUIET = 350; // ms without a change, after which the server is asked
const CHOICES = ["vehicle", "tire", "left", "right", "rear", "steer"];
const SLIDERS = ["point", "friction", "gust", ...Object.keys(PARTS)];
const TIRES = { linear: "linear (never slides)", tanh: "tanh (smooth)", fiala: "Fiala (brush model)", magic_formula: "Magic Formula" };
const AS_PRESET = Object.fromEntries(Object.keys(PARTS).map((part) => [part, 100]));
const LARGEST = 100e6; // bytes of a policy file
const tasks = Object.fromEntries(
  await Promise.all(data.tires.map(async (tire) => [tire, await import(`./task_${tire}.mjs`)])),
);
const dark = matchMedia("(prefers-color-scheme: dark)");
const hand = new Hand(tasks[data.tires[0]].exported_rules.control_timestep);

let { chosen, complaints } = fromHash(data, location.hash);
let shown = null, flow = null, now = 0, playing = null, plane = null, file = null;
let gains = { key: "", found: null }, asked = { portrait: null, recoverable: null }, waiting = null, timer = 0, later = 0;

const preset = () => data.presets[chosen.vehicle];
const driven = () => Object.entries(SIDES).map(([side, style]) => ({ ...style, ...shown[side] })).filter(({ columns }) => columns);
const byHand = () => chosen.left === "you";
const duration = () => Math.max(0, ...driven().map(({ columns }) => columns.time.at(-1)));

function compute() {
  const points = pointsOf(data, chosen), point = points[chosen.point], speed = point.metres_per_second;
  const body = bodyOf(data, chosen), world = placed(tasks[chosen.tire], body, speed, chosen);
  const linear = placed(tasks.linear, body, speed, chosen);
  const before = shown;
  shown = { body, points, point, world, linear, straight: straight(body, speed) };
  shown.start = started(world, chosen.sideslip * DEGREE, chosen.yaw_rate * DEGREE).state;
  askGains();
  for (const side of Object.keys(SIDES)) drive(side, before);
}

// Run a side's car. While its gains are on their way it is drawn as `before`.
function drive(side, before = null) {
  const word = chosen[side], who = driver(word, {
    ...{ steer: chosen.steer, rear: chosen.rear, file: file?.parts, hand, names: data.observation_names },
    ...{ gains: shown.point.lqr?.[chosen.steer] ?? gains.found, pending: gains.pending },
  });
  const start = [chosen.sideslip * DEGREE, chosen.yaw_rate * DEGREE];
  const name = whoInWords(word, chosen, file?.name);
  if (who.pending && before?.[side].columns && word !== "you") shown[side] = before[side];
  else if (who.why) shown[side] = { who: name, why: who.why };
  else {
    const made = word === "you" ? new Run(shown.world, who, ...start) : run(shown.world, who, ...start);
    shown[side] = Object.assign(made, { who: name, car: shown.world.car });
  }
}

// LQR of a changed car, and of one axle alone, comes from the server.
async function askGains() {
  const { steer } = chosen, speed = shown.point.metres_per_second;
  const wanted = [chosen.left, chosen.right].includes("lqr") || (byHand() && chosen.rear === "lqr");
  const question = { ask: "lqr", vehicle: chosen.vehicle, changes: changes(data, chosen), speed, steer };
  const key = JSON.stringify(question);
  if (gains.key === key) return;
  const needed = data.served && wanted && !shown.point.lqr?.[steer];
  gains = { key: needed ? key : "", found: null, pending: needed };
  if (!needed) return;
  const mine = gains;
  try {
    mine.found = await ask(question);
  } catch (error) {
    complaints = [error.message];
  }
  mine.pending = false;
  if (gains !== mine) return;
  stop();
  for (const side of Object.keys(SIDES)) drive(side);
  showControls();
  drawNow();
}

// Orbits take longer than the rest: they follow in slices when it is painted, and only where the car, not the start, has changed.
function computeOrbits() {
  const key = JSON.stringify([shown.body, chosen.tire, shown.point.metres_per_second, chosen.friction]);
  if (flow?.key === key) return;
  flow = { key, found: [] };
  const mine = flow, { world } = shown;
  const box = { sideslip: BOX.sideslip * DEGREE, yawRate: BOX.yaw_rate * DEGREE };
  const stable = eigenvalues(shown.straight).every(([real]) => real < 0), left = grid(box, GRID);
  const some = () => {
    if (flow !== mine) return;
    for (const until = performance.now() + SLICE; left.length && performance.now() < until; ) {
      mine.found.push(orbit(world, stable, box, ...left.pop(), SECONDS));
    }
    if (left.length) setTimeout(some);
    else drawPlane();
  };
  setTimeout(some);
}

// The phase plane's steady turns and recoverable set: of the server, or, of a preset as first shown, from the page's data.
function askForPlane() {
  const about = { vehicle: chosen.vehicle, changes: changes(data, chosen), speed: shown.point.metres_per_second };
  const road = { tire: chosen.tire, friction: chosen.friction }, key = JSON.stringify([about, road, chosen.steer, chosen.recoverable]);
  if (asked.key === key) return;
  clearTimeout(timer);
  waiting?.abort();
  asked = { key, portrait: null, recoverable: null };
  const mine = asked, wants = chosen.recoverable === "on";
  const say = (words, busy = false) => {
    at("asked").textContent = words;
    at("spinner").hidden = !busy;
  };
  if (!data.served) {
    const { exported } = preset(), usual = !isChanged(chosen) && chosen.tire === "fiala" && chosen.friction === 1;
    if (usual && exported && exported.metres_per_second === about.speed) {
      mine.portrait = exported.portrait;
      if (wants && chosen.steer === "both") mine.recoverable = exported.recoverable;
    }
    at("recoverable").disabled = !mine.recoverable && wants;
    say(mine.portrait && (mine.recoverable || !wants) ? "" : "Steady turns and the green set of other cars, speeds and roads are computed by Python: start “bicycle-env explore” on your machine.");
    return;
  }
  waiting = new AbortController();
  const { signal } = waiting;
  say("looking for steady turns", true);
  timer = setTimeout(async () => {
    try {
      mine.portrait = await ask({ ask: "portrait", ...about, ...road }, signal);
      if (asked !== mine) return;
      drawPlane();
      if (wants) {
        say("computing from where some steering saves the car", true);
        mine.recoverable = await ask({ ask: "recoverable", ...about, ...road, steer: chosen.steer }, signal);
      }
      const whole = mine.portrait && (mine.recoverable || !wants);
      if (asked === mine) say(whole ? "" : "Another page has asked in between: change something here to ask again.");
    } catch (error) {
      if (asked === mine) say(error.message);
    }
    if (asked === mine) drawPlane();
  }, QUIET);
}

function showControls() {
  const { point, body, straight: found } = shown, heading = speedInWords(data, point.metres_per_second, found.critical_speed);
  at("point").max = shown.points.length - 1;
  for (const name of [...CHOICES, ...SLIDERS]) at(name).value = chosen[name];
  for (const name of ["sideslip", "yaw_rate"]) {
    if (document.activeElement !== at(name)) at(name).value = Number(chosen[name].toFixed(2));
  }
  for (const [part, { unit, per, digits }] of Object.entries(PARTS)) {
    const words = `${(body[part] / per).toFixed(digits)} ${unit}`;
    at(`${part}_words`).textContent = words;
    at(part).setAttribute("aria-valuetext", words);
  }
  at("as_preset").disabled = !isChanged(chosen);
  at("source").textContent = isChanged(chosen) ? `Changed from the preset ${chosen.vehicle}: what the list says of it holds no more.` : preset().source.replaceAll("`", "");
  at("speed_words").textContent = heading;
  at("point").setAttribute("aria-valuetext", heading);
  at("friction_words").textContent = `${chosen.friction}${chosen.friction < 0.25 ? " (ice)" : chosen.friction < 0.5 ? " (snow)" : ""}`;
  at("gust_words").textContent = chosen.gust ? `${Math.abs(chosen.gust)} N to the ${chosen.gust > 0 ? "left" : "right"}` : "none";
  at("here").textContent = `${heading}.`;
  at("sentence").textContent = stabilityInWords(data, found);
  at("trained").hidden = ![chosen.left, chosen.right].includes("policy");
  at("by_hand").hidden = at("hands").hidden = !byHand();
  at("rear_choice").hidden = !byHand() || chosen.steer !== "both";
  at("policy_file").hidden = ![chosen.left, chosen.right].includes("file");
  at("file_name").textContent = file ? `At the wheel: ${file.name}.` : "";
  at("recoverable").checked = chosen.recoverable === "on";
  for (const [side, { letter }] of Object.entries(SIDES)) {
    at(`ending_${side}`).textContent = `Car ${letter}, ${shown[side].who}: ${ending(shown[side])}.`;
  }
  at("complaint").hidden = complaints.length === 0;
  at("complaint").textContent = complaints.join(" ");
  at("python").textContent = asPython(data, chosen, shown.start, hand.steered);
  at("copied").textContent = "";
  at("time").max = duration();
}

function drawPlane() {
  const orbits = flow?.found ?? [], { width, height } = at("phase").getBoundingClientRect();
  const key = [flow?.key, orbits.length, asked.key, !!asked.portrait, !!asked.recoverable, width, height, devicePixelRatio, dark.matches].join();
  plane = drawPhase(at("phase"), { chosen, cars: driven(), orbits, asked, now, key });
}

function drawNow() {
  const { start, duration: blows } = data.gust, gust = now >= start && now < start + blows ? chosen.gust : 0;
  const cars = Object.keys(SIDES).map((side) => ({
    ...{ ...SIDES[side], ...shown[side], who: WHO[chosen[side]] },
    ending: shown[side].why ? "does not drive" : ending(shown[side]),
  }));
  road(at("road"), cars, now, data.half_width, gust);
  drawHistories(at, driven(), Math.max(duration(), 0.1), now);
  drawPlane();
  at("time").value = now;
  at("time_words").textContent = `${now.toFixed(2)} s`;
}

// The responses are further down: they follow when the rest is painted.
function drawCar() {
  drawEigenvalues(at("eigenvalues"), shown.body, shown.points, shown.point);
  clearTimeout(later);
  later = setTimeout(() => {
    at("wrong_way").textContent = drawResponses(at, shown.body, shown.point.metres_per_second, shown.linear);
  });
}

function update(wanted = {}) {
  const speed = pointsOf(data, chosen)[chosen.point].metres_per_second, isOther = Object.keys(PARTS).some((part) => part in wanted);
  Object.assign(chosen, wanted);
  if (isOther && !("point" in wanted)) chosen.point = nearest(pointsOf(data, chosen), speed);
  stop();
  now = 0;
  hand.reset();
  compute();
  showControls();
  drawCar();
  askForPlane();
  drawNow();
  computeOrbits();
  history.replaceState(null, "", toHash(data, chosen));
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
    const wasOver = hands.every((side) => shown[side].over);
    for (const side of hands) shown[side].until(now);
    const over = hands.every((side) => shown[side].over);
    if (over && !wasOver) showControls();
    if (over) now = Math.min(now, duration());
    drawNow();
    if (!over || now < duration()) playing = requestAnimationFrame(frame);
    else stop();
  };
  playing = requestAnimationFrame(frame);
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
    if (given.some(({ size }) => size > LARGEST)) throw new Error(`A policy file must not be larger than ${LARGEST / 1e6} MB.`);
    const files = await Promise.all(given.map(async (one) => ({ name: one.name, bytes: new Uint8Array(await one.arrayBuffer()) })));
    file = { name: files.map(({ name }) => name).sort()[0], parts: await read(files) };
    choose([chosen.left, chosen.right].includes("file") ? {} : { right: "file" });
  } catch (error) {
    complaints = [error.message];
    showControls();
  }
}

// Of what is dropped: the files, and those of a folder that belong to a policy.
async function dropped({ items }) {
  const entries = [...items].map((item) => item.webkitGetAsEntry?.()).filter(Boolean);
  const fileOf = (entry) => new Promise((resolve, reject) => entry.file(resolve, reject));
  const inside = (entry) => new Promise((resolve, reject) => entry.createReader().readEntries(resolve, reject));
  const listed = await Promise.all(entries.map(async (entry) =>
    entry.isDirectory ? (await inside(entry)).filter(({ name }) => ["policy.json", "policy.safetensors"].includes(name)) : [entry]));
  return Promise.all(listed.flat().map(fileOf));
}

const fill = (select, words) => select.replaceChildren(...Object.entries(words).map(([value, text]) => new Option(text, value)));

fill(at("vehicle"), Object.fromEntries(Object.entries(data.presets).map(([name, { critical_speed }]) => [
  name, `${name}: ${critical_speed === null ? "stable at every speed" : `unstable above ${(3.6 * critical_speed).toFixed(0)} km/h`}`,
])));
fill(at("tire"), Object.fromEntries(data.tires.map((tire) => [tire, TIRES[tire] ?? tire.replaceAll("_", " ")])));
fill(at("left"), WHO);
fill(at("right"), OTHERS);
fill(at("rear"), REAR);
fill(at("steer"), STEER);
at("trained").textContent = data.trained;
for (const [part, { words }] of Object.entries(PARTS)) {
  const label = document.createElement("label"), output = document.createElement("output"), slider = document.createElement("input");
  Object.assign(output, { id: `${part}_words` });
  Object.assign(slider, { id: part, type: "range", min: PERCENT.least, max: PERCENT.most, step: 1 });
  label.append(`${words} `, output, slider);
  at("parts").append(label);
}
at("change").open = isChanged(chosen);

at("vehicle").addEventListener("change", ({ target }) => {
  const to = data.presets[target.value];
  const same = (to.critical_speed === null) === (preset().critical_speed === null) && !isChanged(chosen);
  const ratio = shown.point.metres_per_second / (preset().critical_speed ?? 1);
  choose({ ...AS_PRESET, vehicle: target.value, point: nearest(to.points, same ? ratio * (to.critical_speed ?? 1) : usualSpeed(to)) });
});
for (const name of CHOICES.slice(1)) at(name).addEventListener("change", ({ target }) => choose({ [name]: target.value }));
for (const name of SLIDERS) at(name).addEventListener("input", ({ target }) => choose({ [name]: Number(target.value) }));
at("as_preset").addEventListener("click", () => choose(AS_PRESET));
at("recoverable").addEventListener("change", ({ target }) => choose({ recoverable: target.checked ? "on" : "off" }));
for (const name of ["sideslip", "yaw_rate"]) {
  at(name).addEventListener("input", ({ target }) => {
    const value = target.valueAsNumber, { least, most, words } = NUMBERS[name];
    complaints = value >= least && value <= most ? [] : [`The start's ${words} must be a number in ${least} to ${most}.`];
    update(complaints.length ? {} : { [name]: value });
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
  ({ chosen, complaints } = fromHash(data, location.hash));
  update();
});
const redraw = () => {
  drawCar();
  drawNow();
};
addEventListener("resize", redraw);
dark.addEventListener("change", redraw);

update();
document.documentElement.dataset.ready = "yes";
