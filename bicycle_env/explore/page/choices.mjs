// What is chosen on the page, as the address bar holds it, and as lines of Python.
export const WHO = {
  nobody: "nobody (wheels straight)",
  lqr: "LQR, a classical law (both axles)",
  policy: "trained policy (both axles)",
};
const PYTHON_WHO = {
  nobody: 'control.make("zero", env.unwrapped)',
  lqr: 'control.make("lqr", env.unwrapped)',
  policy: 'bicycle_env.load_policy("ENV_ID")',
};
export const NUMBERS = {
  friction: { least: 0.1, most: 1.2, words: "friction" },
  sideslip: { least: -25, most: 25, words: "sideslip [deg]" },
  yaw_rate: { least: -60, most: 60, words: "yaw rate [deg/s]" },
};
export const DEGREE = Math.PI / 180;

// Of a preset, the index of the speed that is nearest to a ratio, or to a speed in m/s.
export function nearest(preset, wanted) {
  const values = preset.points.map(speedOf);
  return values.reduce((best, value, k) => (Math.abs(value - wanted) < Math.abs(values[best] - wanted) ? k : best), 0);
}

export const speedOf = (point) => point.speed_ratio ?? point.speed;

export function usual(data) {
  const vehicle = Object.keys(data.presets)[0];
  const preset = data.presets[vehicle];
  return {
    vehicle,
    tire: "fiala",
    point: nearest(preset, usualSpeed(preset)),
    friction: 1,
    left: "nobody",
    right: "lqr",
    sideslip: 4,
    yaw_rate: 0,
  };
}

export const usualSpeed = (preset) => (preset.critical_speed === null ? 30 : 1.2);

export function toHash(data, chosen) {
  const { point, ...others } = chosen;
  const at = data.presets[chosen.vehicle].points[point];
  const speed = at.speed_ratio === undefined ? { speed: at.speed } : { speed_ratio: at.speed_ratio };
  return `#${new URLSearchParams({ ...others, ...speed })}`;
}

// { chosen, complaints }: what is not understood stays as usual, with a sentence.
export function fromHash(data, hash) {
  const chosen = usual(data), complaints = [];
  const given = new URLSearchParams(hash.replace(/^#/, ""));
  const words = {
    vehicle: Object.keys(data.presets),
    tire: data.tires,
    left: Object.keys(WHO),
    right: Object.keys(WHO),
  };
  for (const [name, allowed] of Object.entries(words)) {
    const word = given.get(name);
    if (word === null) continue;
    if (allowed.includes(word)) chosen[name] = word;
    else complaints.push(`The address asks for ${name} “${word}”; there are ${allowed.join(", ")}.`);
  }
  for (const [name, { least, most, words }] of Object.entries(NUMBERS)) {
    const text = given.get(name);
    if (text === null) continue;
    const value = Number(text);
    if (text.trim() !== "" && value >= least && value <= most) chosen[name] = value;
    else complaints.push(`The address asks for ${words} ${text}; it must be in ${least} to ${most}.`);
  }
  const preset = data.presets[chosen.vehicle];
  const kind = preset.critical_speed === null ? "speed" : "speed_ratio";
  chosen.point = nearest(preset, usualSpeed(preset));
  if (given.has(kind)) {
    const wanted = Number(given.get(kind));
    chosen.point = Number.isFinite(wanted) ? nearest(preset, wanted) : chosen.point;
    if (speedOf(preset.points[chosen.point]) !== wanted)
      complaints.push(`The address asks for ${kind} ${given.get(kind)}; shown is ${speedOf(preset.points[chosen.point])}.`);
  }
  return { chosen, complaints };
}

// Lines that reproduce what is shown; `start`: the state at the start.
export function asPython(data, chosen, start) {
  const point = data.presets[chosen.vehicle].points[chosen.point];
  const speed = point.speed_ratio === undefined ? `speed=${point.speed}` : `speed_ratio=${point.speed_ratio}`;
  const state = ["heading", "lateral_velocity", "yaw_rate"].map((name) => `"${name}": ${start[name]}`).join(", ");
  const who = [...new Set([chosen.left, chosen.right])].map((word) => `    ${PYTHON_WHO[word]},`);
  return `\
import gymnasium as gym

import bicycle_env
from bicycle_env import analysis, control

keywords = dict(vehicle="${chosen.vehicle}", ${speed}, tire="${chosen.tire}", friction=${chosen.friction})
env = gym.make("ENV_ID", **keywords)
print(analysis.eigenvalues("${chosen.vehicle}", env.unwrapped.speed))
start = {${state}}
for policy in (
${who.join("\n")}
):
    policy.reset()
    observation, info = env.reset(options={"state": start})
    over = False
    while not over:
        observation, reward, terminated, truncated, info = env.step(policy.act(observation))
        over = terminated or truncated
    print(policy.name, env.unwrapped.state.time, info["end"] or "time is over", env.unwrapped.state)
`.replaceAll("ENV_ID", data.env_id);
}

// How a run ended, in a sentence.
export function ending(result) {
  const last = result.columns.time.at(-1).toFixed(2);
  if (result.end === "spun") return `spun after ${last} s`;
  if (result.end === "left_lane") return `left its lane after ${last} s`;
  if (result.end) return `${result.end.replaceAll("_", " ")} after ${last} s`;
  if (result.settledAfter !== null) return `runs straight in its lane from ${result.settledAfter.toFixed(2)} s on`;
  return `still in its lane after ${last} s, but not running straight in its middle`;
}
