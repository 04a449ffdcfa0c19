// The page: what is chosen, what follows from it, and the canvases on which that is drawn.
import { asPython, DEGREE, ending, fromHash, nearest, NUMBERS, speedOf, toHash, usualSpeed, WHO } from "./choices.mjs";
import { data } from "./data.mjs";
import { arrow, axes, cross, curve, dot, road, write } from "./drawing.mjs";
import { driver, grid, orbit, placed, run, started } from "./simulation.mjs";

const at = (id) => document.getElementById(id);
const SIDES = { left: { color: "a", letter: "A", dashes: [] }, right: { color: "b", letter: "B", dashes: [7, 4] } };
const HISTORIES = { sideslip: "Sideslip [deg]", yaw_rate: "Yaw rate [deg/s]", front_steer: "Front steer [deg]", rear_steer: "Rear steer [deg]" };
const BOX = { sideslip: 28, yaw_rate: 68 }; // what the phase plane shows, deg and deg/s
const GRID = 9, SECONDS = 4, SLICE = 12; // of the orbits; ms in which nothing else is done
const tasks = Object.fromEntries(
  await Promise.all(data.tires.map(async (tire) => [tire, await import(`./task_${tire}.mjs`)])),
);

let { chosen, complaints } = fromHash(data, location.hash);
let shown = null, flow = null, now = 0, playing = null, plane = null;

const preset = () => data.presets[chosen.vehicle];
const point = () => preset().points[chosen.point];

function fill(select, words) {
  select.replaceChildren(...Object.entries(words).map(([value, text]) => new Option(text, value)));
}

function compute() {
  const world = placed(tasks[chosen.tire], preset(), point(), chosen.friction);
  const start = [chosen.sideslip * DEGREE, chosen.yaw_rate * DEGREE];
  const result = (side) => run(world, driver(chosen[side], point()), ...start);
  shown = { world, start: started(world, ...start).state, left: result("left"), right: result("right") };
}

// Orbits take longer than the rest: they follow in slices when it is painted, and only where the car, not the start, has changed.
function computeOrbits() {
  const key = JSON.stringify([chosen.vehicle, chosen.tire, chosen.point, chosen.friction]);
  if (flow?.key === key) return;
  flow = { key, found: [] };
  const mine = flow, { world } = shown;
  const box = { sideslip: BOX.sideslip * DEGREE, yawRate: BOX.yaw_rate * DEGREE };
  const stable = point().eigenvalues.every(([real]) => real < 0), left = grid(box, GRID);
  const some = () => {
    if (flow !== mine) return;
    for (const until = performance.now() + SLICE; left.length && performance.now() < until; ) {
      mine.found.push(orbit(world, stable, box, ...left.pop(), SECONDS));
    }
    if (left.length) setTimeout(some);
    else drawPhase();
  };
  setTimeout(some);
}

function showControls() {
  const place = point();
  for (const name of ["vehicle", "tire", "left", "right", "point", "friction"]) at(name).value = chosen[name];
  for (const name of ["sideslip", "yaw_rate"]) {
    if (document.activeElement !== at(name)) at(name).value = Number(chosen[name].toFixed(2));
  }
  at("source").textContent = preset().source.replaceAll("`", "");
  at("speed_words").textContent = place.heading;
  at("point").setAttribute("aria-valuetext", place.heading);
  at("friction_words").textContent = `${chosen.friction}${chosen.friction < 0.25 ? " (ice)" : chosen.friction < 0.5 ? " (snow)" : ""}`;
  at("here").textContent = `${place.heading}.`;
  at("sentence").textContent = place.sentence;
  at("trained").hidden = ![chosen.left, chosen.right].includes("policy");
  for (const side of Object.keys(SIDES)) {
    at(`ending_${side}`).textContent = `Car ${SIDES[side].letter}, ${WHO[chosen[side]]}: ${ending(shown[side])}.`;
  }
  at("complaint").hidden = complaints.length === 0;
  at("complaint").textContent = complaints.join(" ");
  at("python").textContent = asPython(data, chosen, shown.start);
  at("copied").textContent = "";
  at("time").max = duration();
}

const duration = () => Math.max(shown.left.columns.time.at(-1), shown.right.columns.time.at(-1));
const degrees = (column) => column.map((value) => value / DEGREE);

function drawPhase() {
  const wide = (name) => [-BOX[name], BOX[name]];
  plane = axes(at("phase"), wide("sideslip"), wide("yaw_rate"), { x: "sideslip [deg]", y: "yaw rate [deg/s]" });
  plane.within(() => {
    for (const { points, settled } of flow?.found ?? []) {
      const scaled = points.map((pair) => pair.map((value) => value / DEGREE));
      curve(plane, scaled.map(([x]) => x), scaled.map(([, y]) => y), "flow", 1);
      arrow(plane, scaled);
      if (settled) dot(plane, ...scaled[0], "calm", 3.5);
    }
    for (const [side, style] of Object.entries(SIDES)) {
      const { columns } = shown[side], k = indexNow(columns);
      curve(plane, degrees(columns.sideslip), degrees(columns.yaw_rate), style.color, 2.5, style.dashes);
      dot(plane, columns.sideslip[k] / DEGREE, columns.yaw_rate[k] / DEGREE, style.color, 6);
    }
    dot(plane, chosen.sideslip, chosen.yaw_rate, "ink", 8, false);
  });
}

const indexNow = ({ time }) => Math.min(Math.round(now / (time[1] - time[0])), time.length - 1);

function drawEigenvalues() {
  const all = preset().points.flatMap(({ eigenvalues }) => eigenvalues);
  const real = all.map(([x]) => x), imaginary = all.map(([, y]) => y);
  const most = Math.max(2, 1.15 * Math.max(...real)), tall = Math.max(2, 1.2 * Math.max(...imaginary));
  const plot = axes(at("eigenvalues"), [1.08 * Math.min(...real), most], [-tall, tall], {
    x: "real part [1/s]: decay (−), growth (+)",
    y: "imaginary part [1/s]",
    behind: ({ pen, px, box, color }) => {
      pen.fillStyle = color("bad");
      pen.fillRect(px(0), box.top, box.right - px(0), box.bottom - box.top);
    },
  });
  preset().points.forEach(({ eigenvalues }, k) => {
    for (const [x, y] of eigenvalues) dot(plot, x, y, "flow", 1.5 + (2.5 * k) / preset().points.length);
  });
  const here = `${(3.6 * point().metres_per_second).toFixed(0)} km/h`, [[first], [second]] = point().eigenvalues;
  point().eigenvalues.forEach(([x, y], k) => {
    cross(plot, x, y, "a");
    if (k === 0 || y !== 0 || plot.px(second) - plot.px(first) > 70) write(plot, x, y, y >= 0 ? -16 : 16, here);
  });
  const words = point().eigenvalues.map(([x, y]) => x.toFixed(2) + (y ? ` ${y > 0 ? "+" : "−"} ${Math.abs(y).toFixed(2)} i` : ""));
  at("eigenvalues").setAttribute("aria-label", `Eigenvalues at this speed: ${words.join(", ")} per second`);
}

function drawHistories() {
  for (const [name, title] of Object.entries(HISTORIES)) {
    const both = Object.keys(SIDES).map((side) => degrees(shown[side].columns[name]));
    const size = Math.max(1, ...both.flat().map(Math.abs)) * 1.1;
    const plot = axes(at(`history_${name}`), [0, duration()], [-size, size], { x: "time [s]", title });
    plot.within(() => {
      Object.entries(SIDES).forEach(([side, style], k) =>
        curve(plot, shown[side].columns.time, both[k], style.color, 2.2, style.dashes));
      curve(plot, [now, now], [-size, size], "soft", 1);
    });
  }
}

function drawNow() {
  const cars = Object.entries(SIDES).map(([side, style]) => ({
    ...style,
    result: shown[side],
    who: WHO[chosen[side]],
    ending: ending(shown[side]),
    car: shown.world.car,
  }));
  road(at("road"), cars, now, data.half_width);
  drawHistories();
  drawPhase();
  at("time").value = now;
  at("time_words").textContent = `${now.toFixed(2)} s`;
}

function update(changes = {}) {
  Object.assign(chosen, changes);
  stop();
  now = 0;
  compute();
  showControls();
  drawEigenvalues();
  drawNow();
  computeOrbits();
  history.replaceState(null, "", toHash(data, chosen));
}

function choose(changes) {
  complaints = [];
  update(changes);
}

function play() {
  if (now >= duration() - 1e-9) now = 0;
  let before = null;
  const frame = (stamp) => {
    now = Math.min(now + (before === null ? 0 : (stamp - before) / 1000), duration());
    before = stamp;
    drawNow();
    if (now < duration()) playing = requestAnimationFrame(frame);
    else stop();
  };
  playing = requestAnimationFrame(frame);
  at("play").textContent = "Pause";
}

function stop() {
  if (playing !== null) cancelAnimationFrame(playing);
  playing = null;
  at("play").textContent = "Play";
}

function startAt(sideslip, yawRate) {
  const within = (name, value) => Math.min(Math.max(value, NUMBERS[name].least), NUMBERS[name].most);
  choose({
    sideslip: Number(within("sideslip", sideslip).toFixed(2)),
    yaw_rate: Number(within("yaw_rate", yawRate).toFixed(2)),
  });
}

fill(at("vehicle"), Object.fromEntries(Object.entries(data.presets).map(([name, { critical_speed }]) => [
  name, `${name} (${critical_speed === null ? "stable at every speed" : `unstable above ${(3.6 * critical_speed).toFixed(0)} km/h`})`,
])));
fill(at("tire"), Object.fromEntries(data.tires.map((tire) => [tire, tire.replace("_", " ")])));
for (const side of Object.keys(SIDES)) fill(at(side), WHO);
at("trained").textContent = data.trained;

at("vehicle").addEventListener("change", ({ target }) => {
  const to = data.presets[target.value], same = (to.critical_speed === null) === (preset().critical_speed === null);
  at("point").max = to.points.length - 1;
  choose({ vehicle: target.value, point: nearest(to, same ? speedOf(point()) : usualSpeed(to)) });
});
for (const name of ["tire", "left", "right"]) at(name).addEventListener("change", ({ target }) => choose({ [name]: target.value }));
for (const name of ["point", "friction"]) at(name).addEventListener("input", ({ target }) => choose({ [name]: Number(target.value) }));
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
  if (x === undefined) return;
  event.preventDefault();
  startAt(chosen.sideslip + x, chosen.yaw_rate + y);
});
at("play").addEventListener("click", () => (playing === null ? play() : stop()));
at("time").addEventListener("input", ({ target }) => {
  stop();
  now = Number(target.value);
  drawNow();
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
  at("point").max = preset().points.length - 1;
  update();
});
const redraw = () => {
  drawEigenvalues();
  drawNow();
};
addEventListener("resize", redraw);
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redraw);

at("point").max = preset().points.length - 1;
update();
document.documentElement.dataset.ready = "yes";
