// Runs of cars and orbits of the phase plane. Every law comes from the traced modules task_*.mjs; there is none here.
import { exported as trained, Network } from "./policy.mjs";

const NOBODY = { act: () => [0, 0], reset: () => {} };

// What is driven: the task's laws on a tire, the car at a point of its preset's speeds, on a road.
export function placed(task, preset, point, friction) {
  const car = task.new_car(), scale = task.new_observation();
  task.on_road(car, preset.body, point.metres_per_second, friction);
  task.scales(scale, car);
  return { task, car, scale, rules: task.exported_rules };
}

// Who steers, by the words of the page; LQR is a network without hidden layers.
export function driver(word, point) {
  if (word === "nobody") return NOBODY;
  if (word === "policy") return new Network(trained);
  const layers = [{ weight: point.lqr, bias: point.lqr.map(() => 0) }];
  return new Network({ layers, output: "clip", hold: 1, history: 1, mirror: null, entries: point.lqr[0].length });
}

// The state at a start: the task's own law, whose box is this one start; the car's course is along its lane.
export function started({ task, car, rules }, sideslip, yawRate) {
  const state = task.new_state(), episode = task.new_episode(), settings = task.new_settings();
  Object.assign(settings, { sideslip, yaw_rate: yawRate });
  task.start(state, episode, { u0: 0.5, u1: 0.5, u2: 1, u3: 1 }, car, rules, settings);
  return { state, episode, settings };
}

// An episode of the environment: columns by name, a row for each control step, and how it ended.
export function run(world, who, sideslip, yawRate) {
  const { task, car, scale, rules } = world;
  const { state, episode, settings } = started(world, sideslip, yawRate);
  const observation = task.new_observation(), outcome = task.new_outcome();
  const columns = Object.fromEntries(["time", "sideslip", ...Object.keys(state)].map((name) => [name, []]));
  const remember = () => {
    for (const [name, value] of Object.entries(state)) columns[name].push(value);
    columns.time.push(episode.steps * rules.control_timestep);
    columns.sideslip.push(sideslipOf(state, car));
  };
  who.reset();
  remember();
  while (outcome.end === 0 && episode.steps < task.step_limit) {
    task.observe(observation, state, episode, scale, car, rules, settings);
    const [front, rear] = who.act(Object.values(observation)).map(Math.fround);
    task.step(state, episode, outcome, state, episode, { front, rear }, car, rules, settings);
    remember();
  }
  const steady = episode.settled_steps >= task.steps_to_settle;
  return {
    columns,
    end: task.end_words[outcome.end],
    settledAfter: outcome.end === 0 && steady ? (episode.steps - episode.settled_steps) * rules.control_timestep : null,
  };
}

// What sideslip means: V / U.
const sideslipOf = (state, car) => state.lateral_velocity / car.speed;

// Without steering: [[sideslip, yaw rate], ...] from a start, and whether it comes back to straight running, which is
// `stable` or not: near it an orbit may pass by.
export function orbit(world, stable, box, sideslip, yawRate, seconds) {
  const { task, car, rules } = world;
  const { state, episode, settings } = started(world, sideslip, yawRate);
  const timestep = rules.control_timestep / rules.substeps, begun = task.new_begun();
  const points = [[sideslipOf(state, car), state.yaw_rate]];
  let inside = true, settled = false;
  for (let n = 1; n * timestep <= seconds && inside && !settled; n++) {
    task.advance(state, state, episode, begun, 0, car, rules, settings);
    if (n % rules.substeps) continue;
    const x = sideslipOf(state, car), y = state.yaw_rate;
    points.push([x, y]);
    inside = Math.abs(x) < 1.3 * box.sideslip && Math.abs(y) < 1.3 * box.yawRate;
    settled = stable && Math.abs(x) < 0.01 * box.sideslip && Math.abs(y) < 0.01 * box.yawRate;
  }
  return { points, settled };
}

// Starts on a grid of so many by so many: [[sideslip, yaw rate], ...].
export function grid(box, count) {
  const at = (n, most) => ((2 * n) / (count - 1) - 1) * most;
  const places = [...Array(count).keys()];
  return places.flatMap((i) => places.map((k) => [at(i, box.sideslip), at(k, box.yawRate)]));
}
