// The views of what is shown: the phase plane, eigenvalues, histories, and the responses to both axles.
import { eigenvalues, fedBack, responses, rightZeros, straight } from "./car.mjs";
import { DEGREE } from "./choices.mjs";
import { arrow, axes, band, cells, cross, curve, decades, diamond, dot, indexAt, write } from "./drawing.mjs";
import { stepResponse, wrongWay } from "./simulation.mjs";

export const BOX = { sideslip: 28, yaw_rate: 68 }; // what the phase plane shows, deg and deg/s
const HISTORIES = { sideslip: "Sideslip [deg]", yaw_rate: "Yaw rate [deg/s]", front_steer: "Front steer [deg]", rear_steer: "Rear steer [deg]" };
const AXLES = { front: [], rear: [7, 4] }; // dashes
const OUTPUTS = { lateral_acceleration: [1, "m/s²"], yaw_rate: [1 / DEGREE, "deg/s"] };
const FREQUENCIES = Array.from({ length: 81 }, (_, k) => 0.05 * 200 ** (k / 80)); // Hz
const SECONDS = 0.6; // of the step responses
const UNSTABLE_PHASE = "At this speed the car is unstable. Wheels that are turned and held, as in the steps, let it spin to the side to which they turn its nose. " +
  "Gain and phase are those of a car that somebody stabilises all the while: to hold a left turn it needs its front wheels to the right (towards low frequencies a phase of ±180 deg), " +
  "or its rear wheels to the left (a phase of 0).";
const WRONG_WAY = "Why: the turned wheels push the car to the left at once. But they push behind the centre of mass, which turns the nose to the right. " +
  "The body then points to the right of where the car goes, and the slip of all tires pushes it to the right, soon more than the turned wheels push it to the left.";
const behind = { key: null, plane: null, copy: null }; // of the phase plane, what does not move
const degrees = (column) => column.map((value) => value / DEGREE);

// `asked`: { portrait, recoverable }, null where it is not known; `key`: of all that does not move. Gives the plot.
export function drawPhase(canvas, { chosen, cars, orbits, asked, now, key }) {
  if (behind.key !== key) Object.assign(behind, { key, plane: drawBehind(canvas, orbits, asked), copy: copyOf(canvas) });
  const { plane, copy } = behind;
  plane.pen.save();
  plane.pen.resetTransform();
  plane.pen.clearRect(0, 0, copy.width, copy.height);
  plane.pen.drawImage(copy, 0, 0);
  plane.pen.restore();
  plane.within(() => {
    for (const { columns, color, dashes } of cars) {
      const k = indexAt(columns, now);
      curve(plane, degrees(columns.sideslip), degrees(columns.yaw_rate), color, 2.5, dashes);
      dot(plane, columns.sideslip[k] / DEGREE, columns.yaw_rate[k] / DEGREE, color, 6);
    }
    for (const { sideslip, yaw_rate, kind } of asked.portrait?.equilibria ?? []) {
      const place = [sideslip / DEGREE, yaw_rate / DEGREE];
      if (kind === "saddle") diamond(plane, ...place, "edge", 7);
      else dot(plane, ...place, "edge", 6, kind.startsWith("stable"));
      write(plane, ...place, kind === "saddle" && place[1] >= 0 ? -17 : 17, kind);
    }
    dot(plane, chosen.sideslip, chosen.yaw_rate, "ink", 8, false);
  });
  return plane;
}

function copyOf(canvas) {
  const copy = document.createElement("canvas");
  Object.assign(copy, { width: canvas.width, height: canvas.height });
  copy.getContext("2d").drawImage(canvas, 0, 0);
  return copy;
}

// The axes, what can be saved, the orbits and edges.
function drawBehind(canvas, orbits, asked) {
  const wide = (name) => [-BOX[name], BOX[name]];
  const plane = axes(canvas, wide("sideslip"), wide("yaw_rate"), {
    x: "sideslip [deg]",
    y: "yaw rate [deg/s]",
    behind: ({ pen, px, py, box, color }) => {
      if (!asked.recoverable) return;
      const { sideslip, yaw_rate, nodes, rows } = asked.recoverable, plot = { pen, px, py, color };
      pen.save();
      pen.beginPath();
      pen.rect(box.left, box.top, box.right - box.left, box.bottom - box.top);
      pen.clip();
      cells(plot, [sideslip / DEGREE, yaw_rate / DEGREE], nodes, rows, "saved");
      pen.restore();
    },
  });
  plane.within(() => {
    for (const { points, settled } of orbits) {
      const scaled = points.map(degrees);
      curve(plane, scaled.map(([x]) => x), scaled.map(([, y]) => y), "flow", 1);
      arrow(plane, scaled);
      if (settled) dot(plane, ...scaled[0], "calm", 3.5);
    }
    for (const edge of asked.portrait?.edges ?? []) {
      curve(plane, edge.map(([x]) => x / DEGREE), edge.map(([, y]) => y / DEGREE), "edge", 2.2, [2, 4]);
    }
  });
  return plane;
}

// `laws`: of the cars whose rear wheels are steered by a gain times the yaw rate. Gives their numbers, in words.
export function drawEigenvalues(canvas, { body, points, point }, laws) {
  const path = points.map(({ metres_per_second }) => eigenvalues(straight(body, metres_per_second)));
  const every = Math.ceil(path.length / 40), all = path.filter((_, k) => k % every === 0);
  const active = laws.filter(({ gain }) => gain > 0), idle = laws.filter(({ gain }) => gain === 0);
  const moved = active.map(({ gain }) => fedBack(body, point.metres_per_second, gain)); // the same of both cars
  const drawn = [...path, ...moved].flat();
  const real = drawn.map(([x]) => x), imaginary = drawn.map(([, y]) => y);
  const most = Math.max(2, 1.15 * Math.max(...real)), tall = Math.max(2, 1.2 * Math.max(...imaginary));
  const plot = axes(canvas, [1.08 * Math.min(...real), most], [-tall, tall], {
    x: "real part [1/s]: decay (−), growth (+)",
    y: "imaginary part [1/s]",
    behind: ({ pen, px, box, color }) => {
      pen.fillStyle = color("bad");
      pen.fillRect(px(0), box.top, box.right - px(0), box.bottom - box.top);
    },
  });
  all.forEach((values, k) => {
    for (const [x, y] of values) dot(plot, x, y, "flow", 1.5 + (2.5 * k) / all.length);
  });
  const values = eigenvalues(straight(body, point.metres_per_second)), [[first], [second]] = values;
  const here = `${(3.6 * point.metres_per_second).toFixed(0)} km/h`;
  values.forEach(([x, y], k) => {
    cross(plot, x, y, "ink");
    if (k === 0 || y !== 0 || plot.px(second) - plot.px(first) > 70) write(plot, x, y, y >= 0 ? -16 : 16, here);
  });
  moved.forEach((pair, k) => {
    for (const [x, y] of pair) dot(plot, x, y, active[k].color, 9 - 3 * k, false);
  });
  const inWords = (pair) => pair.map(([x, y]) => x.toFixed(2).replace("-", "−") + (Math.abs(y) > 0.005 ? ` ${y > 0 ? "+" : "−"} ${Math.abs(y).toFixed(2)} i` : "")).join(", ");
  const named = (cars) => cars.map(({ letter }) => `car ${letter}`).join(" and ");
  const others = active.length ? `Circles: ${named(active)} with rear wheels after the yaw rate (${inWords(moved[0])} per second).`
    : idle.length ? `This car at this speed needs no yaw-rate feedback: ${named(idle)} has the speed's ratio alone.`
    : "";
  const said = `At this speed: ${inWords(values)} per second. ${others}`;
  canvas.setAttribute("aria-label", `Eigenvalues. ${said}`);
  return said;
}

// `at(id)`: the canvases; `cars`: with what each is drawn with.
export function drawHistories(at, cars, duration, now) {
  for (const [name, title] of Object.entries(HISTORIES)) {
    const all = cars.map(({ columns }) => degrees(columns[name]));
    const size = Math.max(1, ...all.flat().map(Math.abs)) * 1.1;
    const limit = cars.map(({ car }) => car[`${name.replace("steer", "angle")}_limit`] / DEGREE).find((angle) => angle < size);
    const words = limit ? `${title}; dotted: the wheels' limit` : title;
    const plot = axes(at(`history_${name}`), [0, duration], [-size, size], { x: "time [s]", title: words });
    plot.within(() => {
      cars.forEach(({ columns, color, dashes }, k) => curve(plot, columns.time, all[k], color, 2.2, dashes));
      curve(plot, [now, now], [-size, size], "soft", 1);
      for (const angle of limit ? [-limit, limit] : []) curve(plot, [0, duration], [angle, angle], "edge", 1.5, [2, 4]);
    });
  }
}

// Both axles: frequency and step responses of the linear car (`world`: on linear tires). Gives what is said
// of the phase, and of the rear wheels' start.
export function drawResponses(at, body, speed, world) {
  const found = responses(body, speed, FREQUENCIES), logarithm = FREQUENCIES.map(Math.log10);
  const range = [logarithm[0], logarithm.at(-1)], xTicks = [0.1, 0.3, 1, 3, 10].map((value) => [Math.log10(value), String(value)]);
  const steps = Object.fromEntries(Object.keys(AXLES).map((axle) => [axle, stepResponse(world, axle, DEGREE, SECONDS)]));
  const wrong = wrongWay(steps.rear);
  for (const [output, [factor, unit]] of Object.entries(OUTPUTS)) {
    const words = output.replace("_", " "), title = words[0].toUpperCase() + words.slice(1);
    const gains = Object.keys(AXLES).map((axle) => found[`${axle}_${output}`].gain.map((value) => Math.log10(value * factor * DEGREE)));
    const phases = Object.keys(AXLES).map((axle) => found[`${axle}_${output}`].phase);
    const low = Math.min(...gains.flat()) - 0.1, high = Math.max(...gains.flat()) + 0.1;
    const gain = axes(at(`gain_${output}`), range, [low, high], { x: "frequency [Hz]", title: `${title}: gain [${unit} per deg]`, xTicks, yTicks: decades(low, high) });
    const turned = phases.flat(), least = 90 * Math.floor(Math.min(...turned, -90) / 90), most = 90 * Math.ceil(Math.max(...turned, 90) / 90);
    const phase = axes(at(`phase_${output}`), range, [least, most], { x: "frequency [Hz]", title: `${title}: phase [deg]`, xTicks, yTicks: quarters(least, most) });
    const curves = Object.keys(AXLES).map((axle) => steps[axle][output].map((value) => value * factor));
    const size = 1.1 * Math.max(...curves.flat().map(Math.abs));
    const step = axes(at(`step_${output}`), [0, SECONDS], [-size, size], { x: "time after the step [s]", title: `${title} [${unit}], step of 1 deg` });
    if (output === "lateral_acceleration" && wrong) band(step, 0, wrong, "wrong");
    Object.entries(AXLES).forEach(([axle, dashes], k) => {
      gain.within(() => curve(gain, logarithm, gains[k], axle, 2.2, dashes));
      phase.within(() => curve(phase, logarithm, phases[k], axle, 2.2, dashes));
      step.within(() => curve(step, steps[axle].time, curves[k], axle, 2.2, dashes));
    });
  }
  const { rear } = rightZeros(body, speed);
  return {
    phase: Number.isFinite(straight(body, speed).time_to_double) ? UNSTABLE_PHASE : "A phase of ±180 deg: the car goes to the other side than the wheels point.",
    wrong: wrong ? `Rear wheels turned to the left: for ${wrong.toFixed(2)} s (shaded) the car accelerates to the left, before it goes to the right.` : "",
    why: wrong ? `${WRONG_WAY} In the formula: a zero at +${rear.toPrecision(3)} 1/s.` : "",
  };
}

function quarters(least, most) {
  const step = most - least > 540 ? 180 : 90, found = [];
  for (let value = least; value <= most; value += step) found.push([value, String(value).replace("-", "−")]);
  return found;
}
