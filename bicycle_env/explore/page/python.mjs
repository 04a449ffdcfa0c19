// What is chosen as lines of Python that reproduce it.
import { changes, isChanged, pointsOf } from "./car.mjs";
import { ACTUATOR_NAMES, actuatorsOf, AXLES, DEGREE, hasRear, SIDES, usualActuators } from "./choices.mjs";
import { LAWS, MANOEUVRES } from "./drivers.mjs";

const WHO = {
  nobody: 'control.make("zero", env.unwrapped)',
  lqr: 'control.make("lqr", env.unwrapped)',
  policy: 'bicycle_env.load_policy("ENV_ID")',
  file: 'control.load("policy")',
};

const float = (value) => (Number.isInteger(value) ? `${value}.0` : String(value));
const table = (fields) => `{${Object.entries(fields).map(([name, value]) => `"${name}": ${value}`).join(", ")}}`;

function gust(chosen, { start, duration, arm }) {
  if (chosen.gust === 0) return "";
  const side = chosen.gust > 0 ? "left" : "right";
  const fields = { force: float(Math.abs(chosen.gust)), side: `"${side}"`, start: float(start), duration: float(duration), arm: float(arm) };
  return `,\n    disturbances=[${table({ name: '"gust"', ...fields })}]`;
}

function actuators(data, chosen) {
  const as = usualActuators(data), found = actuatorsOf(chosen);
  const other = AXLES.filter((axle) => ACTUATOR_NAMES.some((name) => name.startsWith(axle) && chosen[name] !== as[name]));
  return other.map((axle) => `,\n    ${axle}_actuator=${table(found[axle])}`).join("");
}

const steered = (isLaw) => `\
class Steered(control.Policy):
    """What was steered by hand, step after step; ${isLaw ? "a law" : "another policy"} at the rear axle."""

    name = "you"

    def __init__(self, wheel, rear):
        self.wheel, self.rear = wheel, rear

    def reset(self, rows=None):
        self.step = 0
        self.rear.reset()

    def act(self, observation):
        front = np.float32(self.wheel[self.step] if self.step < len(self.wheel) else 0.0)
        self.step += 1
${isLaw
    ? "        return np.array([front, self.rear.act(front, observation)], np.float32)"
    : "        action = self.rear.act(observation)\n        action[0] = front\n        return action"}


`;

const FIELD = `\
class Field(Stabilise):
    """Not a lane but an open field; half its width in m."""

    road_half_width = HALF


bicycle_env.register("My/Field-v0", Field)

`;

// A side's policy.
function policy(chosen, side, wheel) {
  const word = chosen[side], rear = hasRear(chosen, side) ? chosen[`${side}_rear`] : "nobody", isLaw = LAWS.includes(rear);
  const law = `control.REAR_LAWS["${rear}"](env.unwrapped)`;
  if (word === "you") return `Steered([${wheel.join(", ")}], ${isLaw ? law : WHO[rear]})`;
  if (word === "preview") return `control.make("preview${isLaw ? `+${rear}` : ""}", env.unwrapped)`;
  if (!(word in MANOEUVRES)) return WHO[word];
  const side_ = chosen.angle < 0 ? "right" : "left", angle = float(Math.abs(chosen.angle) * DEGREE);
  const driver = `control.Scripted(\n        env.unwrapped, ${table({ name: `"${word}"`, [MANOEUVRES[word]]: angle, side: `"${side_}"` })}\n    )`;
  return isLaw ? `control.DriverAndLaw(${driver}, ${law})` : driver;
}

// Lines that reproduce what is shown; `start`: the state at the start; `wheel`: what was steered by hand.
export function asPython(data, chosen, start, wheel = []) {
  const point = pointsOf(data, chosen)[chosen.point], changed = Object.entries(changes(data, chosen));
  const speed = point.speed_ratio === undefined ? `speed=${point.speed}` : `speed_ratio=${point.speed_ratio}`;
  const state = table(Object.fromEntries(["heading", "lateral_velocity", "yaw_rate"].map((name) => [name, start[name]])));
  const hands = chosen.left === "you", field = chosen.area === "field";
  const words = SIDES.map((side) => policy(chosen, side, wheel) + (chosen[side] === "file" ? ",  # the folder of your policy" : ","));
  const replaced = changed.map(([part, value]) => `, ${part}=${float(value)}`).join("");
  const vehicle = changed.length
    ? `dataclasses.replace(bicycle_env.vehicles["${chosen.vehicle}"]${replaced})`
    : `bicycle_env.vehicles["${chosen.vehicle}"]`;
  const limits = "(env.unwrapped.front_actuator.angle_limit, env.unwrapped.rear_actuator.angle_limit)";
  const recoverable = chosen.recoverable === "on"
    ? `limits = ${limits}\nsaved = analysis.recoverable_set(\n    vehicle, speed, **road, steer="${chosen.steer}", steer_limits=limits, grid=(121, 121)\n)\n` +
      `print(saved.contains(env.unwrapped.speed * ${chosen.sideslip * DEGREE}, ${chosen.yaw_rate * DEGREE}))\n`
    : "";
  const relaxed = chosen.relaxation_length > 0 ? `, relaxation_length=${float(chosen.relaxation_length)}` : "";
  return `\
${isChanged(chosen) ? "import dataclasses\n\n" : ""}import gymnasium as gym
${hands ? "import numpy as np\n" : ""}
import bicycle_env
from bicycle_env import analysis, control
${field ? "from bicycle_env.tasks import Stabilise\n" : ""}
${hands ? `\n${steered(LAWS.includes(chosen.left_rear) && hasRear(chosen, "left"))}` : ""}${field ? `\n${FIELD.replace("HALF", float(data.half_width.field))}` : ""}\
vehicle = ${vehicle}
road = dict(tire="${chosen.tire}", friction=${float(chosen.friction)})
keywords = dict(vehicle=vehicle, ${speed}, steer="${chosen.steer}", **road${relaxed}${gust(chosen, data.gust)}${actuators(data, chosen)})
env = gym.make("${field ? "My/Field-v0" : "ENV_ID"}", **keywords)
start = ${state}
for policy in (
${[...new Set(words)].map((word) => `    ${word}`).join("\n")}
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
print("a deviation doubles every", analysis.modes(vehicle, speed).time_to_double, "s")
print(analysis.equilibria(vehicle, speed, (0.0, 0.0), **road))
${recoverable}`.replaceAll("ENV_ID", data.env_id);
}
