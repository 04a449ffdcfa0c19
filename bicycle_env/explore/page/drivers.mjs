// Who steers: nobody, a policy, a driver or a hand at the front wheels with a law at the rear ones. The laws are those of
// the traced module steering.mjs, and weights; there is none here.
import { exported as trained, Network } from "./policy.mjs";
import * as steering from "./steering.mjs";

const NOBODY = { act: () => [0, 0], reset: () => {} };
const STRAIGHT = { act: () => 0, reset: () => {} };
export const MANOEUVRES = { step: "angle", sine_with_dwell: "amplitude" }; // and what the page chooses of each
export const AT_FRONT = ["preview", ...Object.keys(MANOEUVRES), "you"]; // another may have the rear wheels
export const LAWS = ["yaw-rate", "zero-sideslip", "speed-dependent", "sano"];

const clipped = (action) => Math.fround(Math.min(Math.max(action, -1), 1));

// A network at the axles that steer; LQR is one without hidden layers.
function network(description, steer) {
  const made = new Network(description);
  const act = (observation) => {
    const action = made.act(observation);
    return steer === "both" ? action : steer === "front" ? [action[0], 0] : [0, action[0]];
  };
  return { act, reset: () => made.reset() };
}

const linear = (weights) => ({
  ...{ layers: [{ weight: weights, bias: weights.map(() => 0) }], output: "clip", hold: 1, history: 1, mirror: null },
  entries: weights[0].length,
});

const axles = ({ layers }) => layers.at(-1).bias.length;

// What is designed for the car, or { why } there is none, or that it is `pending`; `called`: in words.
function designed(name, called, { design }) {
  const { found, pending, why } = design(name);
  if (found) return found;
  if (pending) return { why: `${called} is being designed for this car`, pending };
  return { why: why ?? `${called} for a changed car or steering is designed by Python: start “bicycle-env explore” on your machine` };
}

// An angle at the front wheels, step after step: { act, reset }, or { why } not.
function front(word, rear, setting) {
  if (word === "you") return { act: () => setting.hand.next(), reset: () => setting.hand.reset() };
  if (word in MANOEUVRES) {
    const numbers = { ...steering[`exported_${word}`], [MANOEUVRES[word]]: Math.abs(setting.angle) };
    const side = setting.angle < 0 ? -1 : 1;
    return { act: (_, { time, world }) => side * steering[word](time, numbers, world.car), reset: () => {} };
  }
  const known = designed(LAWS.includes(rear) ? `preview+${rear}` : "preview", "the driver", setting);
  if (known.why) return known;
  const wanted = new Network(linear(known.weights)), waiting = [];
  return {
    act: (observation) => {
      waiting.push(wanted.act(observation)[0]);
      return waiting.shift();
    },
    reset: () => {
      wanted.reset();
      waiting.splice(0, waiting.length, ...Array(known.delay).fill(0));
    },
  };
}

// Likewise at the rear wheels, after the front ones' action.
function behind(word, setting) {
  if (word === "nobody" || setting.steer === "front") return STRAIGHT;
  if (!LAWS.includes(word)) {
    const other = driver(word, setting);
    return other.why ? other : { act: (_, observation) => other.act(observation)[1], reset: () => other.reset() };
  }
  const known = word === "sano" ? {} : designed(word, `the law “${word}”`, setting); // Sano's is one for all cars
  if (known.why) return known;
  const law = steering[word.replace("-", "_")], found = steering.new_rear(), numbers = word === "sano" ? [] : [known.rear];
  return {
    act: (action, _, { observation, world }) => {
      law(found, action, observation.yaw_rate, world.scale.yaw_rate, found.remembered, ...numbers, world.car);
      return found.action;
    },
    reset: () => Object.assign(found, steering.new_rear()),
    gain: known.rear?.yaw_rate_gain,
  };
}

// Who steers, by the words of the page: { act, reset }, or { why } not; the `gain` [s] of the rear wheels after the yaw
// rate, if they are steered so. `design(name)`: what is designed for this car;
// `file`: a network's parts; `hand`: at the wheel; `angle`: of a manoeuvre, rad; `names`: of the observation that `env_id` shows.
export function driver(word, setting) {
  const { steer, rear, file, names, env_id } = setting;
  if (word === "nobody") return NOBODY;
  if (AT_FRONT.includes(word)) {
    if (steer === "rear") return { why: "cannot steer: a driver has the front axle, and here only the rear one steers" };
    const parts = [front(word, steer === "both" ? rear : "nobody", setting), behind(rear, setting)];
    const missing = parts.find(({ why }) => why);
    if (missing) return missing;
    return {
      act: (observation, run) => {
        const action = clipped(parts[0].act(observation, run));
        return [action, parts[1].act(action, observation, run)];
      },
      reset: () => parts.forEach((part) => part.reset()),
      gain: parts[1].gain,
    };
  }
  if (word === "lqr") {
    const known = designed(`lqr ${steer}`, "LQR", setting);
    return known.why ? known : network(linear(known.weights), steer);
  }
  const parts = word === "policy" ? trained : file;
  if (!parts) return { why: "no policy file yet: drop its files on the page, or choose them" };
  if (word === "file" && JSON.stringify(parts.names) !== JSON.stringify(names)) {
    const many = parts.names.length === names.length ? "other entries" : `${parts.names.length} entries, not ${names.length}`;
    return { why: `this policy${parts.env_id && ` was trained for ${parts.env_id}, and`} does not see what ${env_id} shows it: ${many}` };
  }
  if (axles(parts) !== (steer === "both" ? 2 : 1)) {
    return { why: `this policy steers ${axles(parts) === 2 ? "both axles" : "one axle"}: choose that under “Which axle steers”` };
  }
  return network(parts, steer);
}
