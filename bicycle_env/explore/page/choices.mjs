// What is chosen on the page, and how the address bar holds it.
import { nearest, PARTS, PERCENT, pointsOf } from "./car.mjs";
import { AT_FRONT, LAWS } from "./drivers.mjs";

export const WHO = {
  nobody: "nobody (wheels straight)",
  step: "a driver who turns in, and holds",
  sine_with_dwell: "a driver who swerves",
  preview: "a driver who looks ahead",
  lqr: "LQR, a classical law",
  policy: "trained policy",
  file: "a policy file of yours",
  you: "you, with the arrow keys",
};
const { you, ...OTHERS } = WHO;
export { OTHERS }; // at the wheel of car B
export const BEHIND = {
  nobody: WHO.nobody,
  "yaw-rate": "yaw-rate feedback",
  "zero-sideslip": "a zero-sideslip filter",
  "speed-dependent": "the speed's ratio",
  sano: "Sano's angle curve",
  lqr: WHO.lqr,
  policy: WHO.policy,
};
export const EXPLAINED = {
  nobody: "The rear wheels stay straight, as in most cars.",
  "yaw-rate": "The faster the car yaws, the further the rear wheels turn to the same side, which holds the yaw back: it moves the eigenvalues (circles). And a share of the front wheels' angle (Toyota, 1991).",
  "zero-sideslip": "After the front wheels alone: first against them, which starts the turn, then with them, so that the car does not slip sideways (the form of Nissan's, 1990). It moves no eigenvalue.",
  "speed-dependent": "The front wheels' angle times a ratio: against them when slow, with them when fast (Mazda, 1987). It moves no eigenvalue.",
  sano: "After the front wheels' angle: small ones with them, large ones against them (Honda, 1987). The same for every car and speed. It moves no eigenvalue.",
  lqr: "What LQR would do with the rear wheels: it wants straight running.",
  policy: "What the trained policy would do with the rear wheels: it wants straight running.",
};
export const STEER = { both: "front and rear axle", front: "front axle alone", rear: "rear axle alone" };
export const AREA = { lane: "a lane", field: "an open field" };
export const DEGREE = Math.PI / 180;
const RADIANS = (value) => value * DEGREE, SECONDS = (value) => value / 1000; // to the bit as Python has it
// Of both axles' actuators: words, unit, to SI units, range and step.
export const ACTUATORS = {
  angle_limit: { words: "wheels, largest angle", unit: "deg", inSI: RADIANS, least: 0.5, most: 12, step: 0.5 },
  rate_limit: { words: "wheels, fastest", unit: "deg/s", inSI: RADIANS, least: 1, most: 100, step: 1 },
  time_constant: { words: "wheels, lag", unit: "ms", inSI: SECONDS, least: 10, most: 300, step: 10 },
};
export const AXLES = ["front", "rear"];
export const ACTUATOR_NAMES = AXLES.flatMap((axle) => Object.keys(ACTUATORS).map((field) => `${axle}_${field}`));
export const SIDES = ["left", "right"];
// What a number may be; `above`: or the least, or at least so much.
export const NUMBERS = {
  friction: { least: 0.1, most: 1.2, words: "friction" },
  sideslip: { least: -25, most: 25, words: "sideslip [deg]" },
  yaw_rate: { least: -60, most: 60, words: "yaw rate [deg/s]" },
  gust: { least: -6000, most: 6000, words: "gust [N]" },
  angle: { least: -6, most: 6, words: "driver's angle [deg]" },
  relaxation_length: { least: 0, most: 1.2, above: 0.2, words: "relaxation length [m]" },
  ...Object.fromEntries(AXLES.flatMap((axle) => Object.entries(ACTUATORS).map(([field, { least, most, unit }]) => [
    `${axle}_${field}`, { least, most, words: `${axle} ${field.replace("_", " ")} [${unit}]` },
  ]))),
  ...Object.fromEntries(Object.keys(PARTS).map((part) => [part, { ...PERCENT, words: `${part} [% of the preset's]` }])),
};
const isAllowed = (value, { least, most, above = least }) => (value >= above && value <= most) || value === least;

// In the units of the page.
export const usualActuators = ({ actuators }) => Object.fromEntries(AXLES.flatMap((axle) =>
  Object.entries(ACTUATORS).map(([field, { inSI }]) => [`${axle}_${field}`, Number((actuators[axle][field] / inSI(1)).toFixed(6))])));

// { front, rear } in SI units.
export const actuatorsOf = (chosen) => Object.fromEntries(AXLES.map((axle) => [
  axle, Object.fromEntries(Object.entries(ACTUATORS).map(([field, { inSI }]) => [field, inSI(chosen[`${axle}_${field}`])])),
]));

// Whether what controllers are designed on, the angle limits and lags, is other than usual.
export const isActuatorChanged = (data, chosen) => Object.entries(usualActuators(data))
  .some(([name, value]) => !name.endsWith("rate_limit") && chosen[name] !== value);

export function usual(data) {
  const vehicle = Object.keys(data.presets)[0];
  return {
    vehicle,
    ...Object.fromEntries(Object.keys(PARTS).map((part) => [part, 100])),
    tire: "fiala",
    relaxation_length: 0,
    point: nearest(data.presets[vehicle].points, usualSpeed(data.presets[vehicle])),
    friction: 1,
    ...usualActuators(data),
    steer: "both",
    area: "lane",
    gust: 0,
    left: "nobody",
    right: "lqr",
    left_rear: "nobody",
    right_rear: "nobody",
    angle: 2,
    sideslip: 4,
    yaw_rate: 0,
    recoverable: "on",
  };
}

// m/s
export const usualSpeed = ({ critical_speed: critical }) => (critical === null ? 30 : 1.2 * critical);

export const speedOf = ({ speed_ratio, speed }) => speed_ratio ?? speed;

// What is where the page's words stop: the world of `placed`.
export const placeOf = (data, chosen) => ({
  ...{ friction: chosen.friction, steer: chosen.steer, gust: chosen.gust, relaxation_length: chosen.relaxation_length },
  ...{ actuators: actuatorsOf(chosen), half_width: data.half_width[chosen.area] },
});

// The traced module of a tire.
export const moduleOf = ({ tire, relaxation_length }) => `task_${tire}${relaxation_length > 0 ? "_relaxed" : ""}`;

// What may have the rear wheels beside a driver at the front ones: a hand may be helped by what wants straight running.
export const behindFor = (who) => Object.fromEntries(Object.entries(BEHIND).filter(([name]) =>
  who === "you" || name === "nobody" || LAWS.includes(name)));

export const hasRear = (chosen, side) => chosen.steer === "both" && AT_FRONT.includes(chosen[side]);

// What is chosen, without what makes no sense beside it.
export function sensible(chosen) {
  const found = { ...chosen };
  for (const side of SIDES) if (!(chosen[`${side}_rear`] in behindFor(chosen[side]))) found[`${side}_rear`] = "nobody";
  return found;
}

// What is as usual is left out, but for what is first asked of a link.
export function toHash(data, chosen) {
  const { point, ...others } = chosen, always = ["vehicle", "tire", "friction", "left", "right", "sideslip", "yaw_rate"];
  const at = pointsOf(data, chosen)[point], as = usual(data);
  const speed = at.speed_ratio === undefined ? { speed: at.speed } : { speed_ratio: at.speed_ratio };
  const kept = Object.entries(others).filter(([name, value]) => always.includes(name) || value !== as[name]);
  return `#${new URLSearchParams({ ...Object.fromEntries(kept), ...speed })}`;
}

// { chosen, complaints }: what is not understood stays as usual, with a sentence.
export function fromHash(data, hash) {
  const chosen = usual(data), complaints = [];
  const given = new URLSearchParams(hash.replace(/^#/, ""));
  const words = {
    vehicle: Object.keys(data.presets),
    tire: data.tires,
    left: Object.keys(WHO),
    right: Object.keys(OTHERS),
    left_rear: Object.keys(BEHIND),
    right_rear: Object.keys(BEHIND),
    steer: Object.keys(STEER),
    area: Object.keys(AREA),
    recoverable: ["on", "off"],
  };
  for (const [name, allowed] of Object.entries(words)) {
    const word = given.get(name);
    if (word === null) continue;
    if (allowed.includes(word)) chosen[name] = word;
    else complaints.push(`The address asks for ${name} “${word}”; there are ${allowed.join(", ")}.`);
  }
  for (const [name, range] of Object.entries(NUMBERS)) {
    const text = given.get(name), { least, most, above, words } = range;
    if (text === null) continue;
    const value = Number(text);
    if (text.trim() !== "" && isAllowed(value, range)) chosen[name] = value;
    else complaints.push(`The address asks for ${words} ${text}; it must be ${above ? `${least}, or ` : ""}in ${above ?? least} to ${most}.`);
  }
  const preset = data.presets[chosen.vehicle], points = pointsOf(data, chosen);
  const kind = points[0].speed_ratio === undefined ? "speed" : "speed_ratio";
  chosen.point = nearest(points, usualSpeed(preset));
  if (given.has(kind)) {
    const wanted = Number(given.get(kind)), unit = kind === "speed" ? 1 : preset.critical_speed;
    if (Number.isFinite(wanted)) chosen.point = nearest(points, wanted * unit);
    if (speedOf(points[chosen.point]) !== wanted)
      complaints.push(`The address asks for ${kind} ${given.get(kind)}; shown is ${speedOf(points[chosen.point])}.`);
  }
  const kept = sensible(chosen);
  for (const side of SIDES) {
    const rear = `${side}_rear`;
    if (kept[rear] !== chosen[rear]) complaints.push(`The address asks for ${rear} “${chosen[rear]}”, which goes with you at the wheel only.`);
  }
  return { chosen: kept, complaints };
}

// What is at a side's wheels, in words; `file`: the name of the policy file, "" for none.
export function whoInWords(side, chosen, file) {
  const word = chosen[side];
  if (word === "file" && file) return `your policy (${file})`;
  const rear = chosen[`${side}_rear`];
  if (hasRear(chosen, side)) return `${WHO[word]}; rear wheels ${rear === "nobody" ? "straight" : `by ${BEHIND[rear]}`}`;
  return WHO[word];
}

// How a run ended, in a sentence; `brief`: without what the task means by straight.
export function ending({ tolerances }, result, area = "lane", brief = false) {
  if (result.why) return result.why;
  const { time, sideslip, heading: turned } = result.columns, last = time.at(-1).toFixed(2);
  if (!result.over) return time.length > 1 ? "on its way" : "press Play and steer: ← and →";
  const degrees = (column) => `${Math.abs(column.at(-1) / DEGREE).toFixed(0)} deg`;
  const sliding = `after ${last} s, with ${degrees(sideslip)} of sideslip`;
  if (result.end === "spun") return `spun ${sliding}, turned by ${degrees(turned)}`;
  if (result.end === "left_lane") return `left ${area === "lane" ? "its lane" : "the field"} ${sliding}`;
  if (result.end) return `${result.end.replaceAll("_", " ")} ${sliding}`;
  const { lateral, heading, yaw_rate } = tolerances, angle = Math.max(heading, tolerances.sideslip) / DEGREE;
  const within = brief ? "" : ` (within ${lateral} m, ${angle.toFixed(1)} deg and ${(yaw_rate / DEGREE).toFixed(1)} deg/s)`;
  if (result.settledAfter !== null) return `runs straight from ${result.settledAfter.toFixed(2)} s on${within}`;
  if (area === "lane") return `still in its lane after ${last} s, but not running straight in its middle`;
  const again = straightFrom(tolerances, result);
  return `has not spun in ${last} s${again === null ? "" : `; runs straight again from ${again.toFixed(2)} s on, but not on its old line`}`;
}

// From when on a car neither slips nor yaws, wherever it goes; null if it does, or not for as long as settling takes.
function straightFrom(tolerances, { columns: { time, sideslip, yaw_rate }, world }) {
  const moves = (_, k) => Math.abs(sideslip[k]) >= tolerances.sideslip || Math.abs(yaw_rate[k]) >= tolerances.yaw_rate;
  const first = time.findLastIndex(moves) + 1;
  return time.length - first > world.task.steps_to_settle ? time[first] : null;
}
