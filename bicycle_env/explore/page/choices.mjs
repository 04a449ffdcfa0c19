// What is chosen on the page, as the address bar holds it, and as lines of Python.
import { changes, isChanged, nearest, PARTS, PERCENT, pointsOf } from "./car.mjs";

export const WHO = {
  nobody: "nobody (wheels straight)",
  lqr: "LQR, a classical law",
  policy: "trained policy",
  file: "a policy file of yours",
  you: "you, with the arrow keys",
};
const { you, ...OTHERS } = WHO;
export { OTHERS }; // at the wheel of car B
export const REAR = { nobody: WHO.nobody, lqr: WHO.lqr, policy: WHO.policy };
export const STEER = { both: "front and rear axle", front: "front axle alone", rear: "rear axle alone" };
const PYTHON_WHO = {
  nobody: 'control.make("zero", env.unwrapped)',
  lqr: 'control.make("lqr", env.unwrapped)',
  policy: 'bicycle_env.load_policy("ENV_ID")',
  file: 'control.load("policy")',
};
export const NUMBERS = {
  friction: { least: 0.1, most: 1.2, words: "friction" },
  sideslip: { least: -25, most: 25, words: "sideslip [deg]" },
  yaw_rate: { least: -60, most: 60, words: "yaw rate [deg/s]" },
  gust: { least: -6000, most: 6000, words: "gust [N]" },
  ...Object.fromEntries(Object.keys(PARTS).map((part) => [part, { ...PERCENT, words: `${part} [% of the preset's]` }])),
};
export const DEGREE = Math.PI / 180;

export function usual(data) {
  const vehicle = Object.keys(data.presets)[0];
  return {
    vehicle,
    ...Object.fromEntries(Object.keys(PARTS).map((part) => [part, 100])),
    tire: "fiala",
    point: nearest(data.presets[vehicle].points, usualSpeed(data.presets[vehicle])),
    friction: 1,
    steer: "both",
    gust: 0,
    left: "nobody",
    right: "lqr",
    rear: "nobody",
    sideslip: 4,
    yaw_rate: 0,
    recoverable: "on",
  };
}

// m/s
export const usualSpeed = ({ critical_speed: critical }) => (critical === null ? 30 : 1.2 * critical);

export const speedOf = ({ speed_ratio, speed }) => speed_ratio ?? speed;

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
    rear: Object.keys(REAR),
    steer: Object.keys(STEER),
    recoverable: ["on", "off"],
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
  const preset = data.presets[chosen.vehicle], points = pointsOf(data, chosen);
  const kind = points[0].speed_ratio === undefined ? "speed" : "speed_ratio";
  chosen.point = nearest(points, usualSpeed(preset));
  if (given.has(kind)) {
    const wanted = Number(given.get(kind)), unit = kind === "speed" ? 1 : preset.critical_speed;
    if (Number.isFinite(wanted)) chosen.point = nearest(points, wanted * unit);
    if (speedOf(points[chosen.point]) !== wanted)
      complaints.push(`The address asks for ${kind} ${given.get(kind)}; shown is ${speedOf(points[chosen.point])}.`);
  }
  return { chosen, complaints };
}

// What is at the wheels, in words; `file`: the name of the policy file, "" for none.
export function whoInWords(word, chosen, file) {
  if (word === "file" && file) return `your policy (${file})`;
  if (word === "you" && chosen.steer === "both") return `${you}; rear axle: ${REAR[chosen.rear]}`;
  return WHO[word];
}

const float = (value) => (Number.isInteger(value) ? `${value}.0` : String(value));

function gustInPython({ gust }, { start, duration, arm }) {
  if (gust === 0) return "";
  const side = gust > 0 ? "left" : "right";
  const fields = { force: float(Math.abs(gust)), side: `"${side}"`, start: float(start), duration: float(duration), arm: float(arm) };
  const words = Object.entries(fields).map(([name, value]) => `"${name}": ${value}`);
  return `,\n    disturbances=[{"name": "gust", ${words.join(", ")}}]`;
}

const STEERED = `\
class Steered(control.Policy):
    """What was steered by hand, step after step; another policy at the rear axle."""

    name = "you"

    def __init__(self, wheel, rear):
        self.wheel, self.rear = wheel, rear

    def reset(self, rows=None):
        self.step = 0
        self.rear.reset()

    def act(self, observation):
        action = self.rear.act(observation)
        action[0] = self.wheel[self.step] if self.step < len(self.wheel) else 0.0
        self.step += 1
        return action


`;

// Lines that reproduce what is shown; `start`: the state at the start; `wheel`: what was steered by hand.
export function asPython(data, chosen, start, wheel = []) {
  const point = pointsOf(data, chosen)[chosen.point], changed = Object.entries(changes(data, chosen));
  const speed = point.speed_ratio === undefined ? `speed=${point.speed}` : `speed_ratio=${point.speed_ratio}`;
  const state = ["heading", "lateral_velocity", "yaw_rate"].map((name) => `"${name}": ${start[name]}`).join(", ");
  const rear = PYTHON_WHO[chosen.steer === "both" ? chosen.rear : "nobody"];
  const made = (word) => (word === "you" ? `Steered([${wheel.join(", ")}], ${rear})` : PYTHON_WHO[word]);
  const words = [...new Set([chosen.left, chosen.right])], hands = words.includes("you");
  const replaced = changed.map(([part, value]) => `, ${part}=${float(value)}`).join("");
  const vehicle = changed.length
    ? `dataclasses.replace(bicycle_env.vehicles["${chosen.vehicle}"]${replaced})`
    : `bicycle_env.vehicles["${chosen.vehicle}"]`;
  const limits = "(env.unwrapped.front_actuator.angle_limit, env.unwrapped.rear_actuator.angle_limit)";
  const recoverable = chosen.recoverable === "on"
    ? `limits = ${limits}\nsaved = analysis.recoverable_set(\n    vehicle, speed, **road, steer="${chosen.steer}", steer_limits=limits, grid=(121, 121)\n)\n` +
      `print(saved.contains(env.unwrapped.speed * ${chosen.sideslip * DEGREE}, ${chosen.yaw_rate * DEGREE}))\n`
    : "";
  return `\
${isChanged(chosen) ? "import dataclasses\n\n" : ""}import gymnasium as gym

import bicycle_env
from bicycle_env import analysis, control

${hands ? `\n${STEERED}` : ""}\
vehicle = ${vehicle}
road = dict(tire="${chosen.tire}", friction=${float(chosen.friction)})
keywords = dict(vehicle=vehicle, ${speed}, steer="${chosen.steer}", **road${gustInPython(chosen, data.gust)})
env = gym.make("ENV_ID", **keywords)
start = {${state}}
for policy in (
${words.map((word) => `    ${made(word)},${word === "file" ? "  # the folder of your policy" : ""}`).join("\n")}
):
    policy.reset()
    observation, info = env.reset(options={"state": start})
    over = False
    while not over:
        observation, reward, terminated, truncated, info = env.step(policy.act(observation))
        over = terminated or truncated
    print(policy.name, env.unwrapped.state.time, info["end"] or "time is over", env.unwrapped.state)

speed = env.unwrapped.speed
print(analysis.eigenvalues(vehicle, speed), analysis.zeros(vehicle, speed, "rear_steer", "lateral_acceleration"))
print(analysis.equilibria(vehicle, speed, (0.0, 0.0), **road))
${recoverable}`.replaceAll("ENV_ID", data.env_id);
}

// How a run ended, in a sentence.
export function ending(result) {
  if (result.why) return result.why;
  const last = result.columns.time.at(-1).toFixed(2);
  if (!result.over) return result.columns.time.length > 1 ? "on its way" : "press Play and steer: ← and →";
  if (result.end === "spun") return `spun after ${last} s`;
  if (result.end === "left_lane") return `left its lane after ${last} s`;
  if (result.end) return `${result.end.replaceAll("_", " ")} after ${last} s`;
  if (result.settledAfter !== null) return `runs straight in its lane from ${result.settledAfter.toFixed(2)} s on`;
  return `still in its lane after ${last} s, but not running straight in its middle`;
}
