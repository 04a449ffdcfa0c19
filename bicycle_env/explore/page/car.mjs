// The car that is chosen, and what is said of it. All figures come from the traced module linear.mjs; there is no law here.
import * as linear from "./linear.mjs";

// What of a preset can be changed, in percent of its value: words, unit, what the shown number is divided by, its digits.
export const PARTS = {
  mass: { words: "Mass", unit: "kg", per: 1, digits: 0 },
  yaw_inertia: { words: "Yaw inertia", unit: "kg m²", per: 1, digits: 0 },
  cg_to_front: { words: "Centre of mass to front axle", unit: "m", per: 1, digits: 2 },
  cg_to_rear: { words: "Centre of mass to rear axle", unit: "m", per: 1, digits: 2 },
  front_cornering_stiffness: { words: "Front cornering stiffness", unit: "kN/rad", per: 1000, digits: 1 },
  rear_cornering_stiffness: { words: "Rear cornering stiffness", unit: "kN/rad", per: 1000, digits: 1 },
};
export const PERCENT = { least: 50, most: 200 };
const OWN_SPEEDS = Array.from({ length: 131 }, (_, k) => 5 + 0.5 * k); // m/s, of a changed car

export const isChanged = (chosen) => Object.keys(PARTS).some((part) => chosen[part] !== 100);

// What was changed, by the field's name, in SI units.
export function changes(data, chosen) {
  const { body } = data.presets[chosen.vehicle];
  const changed = Object.keys(PARTS).filter((part) => chosen[part] !== 100);
  return Object.fromEntries(changed.map((part) => [part, Number(((body[part] * chosen[part]) / 100).toPrecision(6))]));
}

export const bodyOf = (data, chosen) => ({ ...data.presets[chosen.vehicle].body, ...changes(data, chosen) });

// The speeds on offer: those of the preset, or, of a changed car, in m/s.
export function pointsOf(data, chosen) {
  if (!isChanged(chosen)) return data.presets[chosen.vehicle].points;
  return OWN_SPEEDS.map((speed) => ({ speed, metres_per_second: speed }));
}

// The index of the speed that is nearest to one in m/s.
export function nearest(points, wanted) {
  const distance = ({ metres_per_second }) => Math.abs(metres_per_second - wanted);
  return points.reduce((best, point, k) => (distance(point) < distance(points[best]) ? k : best), 0);
}

export function straight(body, speed) {
  const found = linear.new_straight_running();
  linear.straight(found, body, speed);
  return found;
}

export const eigenvalues = ({ first_real, first_imaginary, second_real, second_imaginary }) => [
  [first_real, first_imaginary],
  [second_real, second_imaginary],
];

// Where the rear wheels are steered by a gain [s] times the yaw rate.
export function fedBack(body, speed, gain) {
  const found = linear.new_eigenvalues();
  linear.fed_back(found, body, speed, gain);
  return eigenvalues(found);
}

// Python's "{name:.2f}" and "{name:.3g}".
const filled = (template, values) =>
  template.replace(/\{(\w+):\.(\d)([fg])\}/g, (_, name, digits, kind) =>
    kind === "f" ? values[name].toFixed(digits) : String(Number(values[name].toPrecision(digits))));

export function speedInWords({ words }, speed, critical) {
  const ratio = Number.isFinite(critical) ? filled(words.ratio, { ratio: speed / critical }) : "";
  return filled(words.speed, { speed, kmh: 3.6 * speed }) + ratio;
}

export function stabilityInWords({ words }, found) {
  const { critical_speed: critical, time_to_double: doubling, yaw_stiffness, criterion } = found;
  const kind = yaw_stiffness > 0 ? "understeer" : yaw_stiffness < 0 ? "oversteer" : "neutral";
  const word = !Number.isFinite(critical) ? "always"
    : Number.isFinite(doubling) ? "unstable"
    : criterion > 0 ? "stable" : "limit";
  const sentence = filled(words.stability[word], { critical, critical_kmh: 3.6 * critical, doubling });
  return `This car ${words.kinds[kind]}; ${sentence}.`;
}

// Of the frequencies [Hz], for each axle and output: { gain, phase } per rad and in degrees, without jumps.
export function responses(body, speed, frequencies) {
  const found = {}, one = linear.new_response();
  for (const axle of ["front", "rear"]) {
    for (const output of ["lateral_acceleration", "yaw_rate"]) found[`${axle}_${output}`] = { gain: [], phase: [] };
  }
  for (const frequency of frequencies) {
    linear.respond(one, body, speed, 2 * Math.PI * frequency);
    for (const [name, { gain, phase }] of Object.entries(found)) {
      const x = one[`${name}_real`], y = one[`${name}_imaginary`];
      gain.push(Math.hypot(x, y));
      const angle = (Math.atan2(y, x) * 180) / Math.PI;
      phase.push(phase.length ? angle - 360 * Math.round((angle - phase.at(-1)) / 360) : angle);
    }
  }
  return found;
}

// The zeros in the right half-plane of the lateral acceleration, 1/s; 0 for none.
export function rightZeros(body, speed) {
  const found = linear.new_zeros();
  linear.right_zeros(found, body, speed);
  return found;
}

export function onRoad(car, body, speed, friction, { front, rear }, relaxationLength) {
  linear.on_road(car, body, speed, friction, front, rear, relaxationLength);
}
