// Runs of cars and orbits of the phase plane. Every law comes from the traced modules task_*.mjs; there is none here.
import { onRoad } from "./car.mjs";

const FINE = 4; // the step responses' timestep is a substep's, divided by this

// What is driven: the task's laws on a tire, the car, a speed [m/s], a road, its actuators, the axles that steer, a gust
// [N], half the width of the lane [m].
export function placed(task, body, speed, { friction, steer, gust, actuators, relaxation_length, half_width }) {
  const car = task.new_car(), scale = task.new_observation();
  onRoad(car, body, speed, friction, actuators, relaxation_length);
  task.scales(scale, car);
  const rules = { ...task.exported_rules, steers_front: steer === "rear" ? 0 : 1, steers_rear: steer === "front" ? 0 : 1 };
  return { task, car, scale, rules, steer, gust, half_width };
}

// The state at a start: the task's own law, whose box is this one start; the car's course is along its lane.
export function started({ task, car, rules, gust, half_width }, sideslip, yawRate) {
  const state = task.new_state(), episode = task.new_episode(), own = task.new_task_state(), side = gust < 0 ? -1 : 1;
  const settings = {
    ...task.exported_settings,
    ...{ lateral_position: 0, course: 0, sideslip, yaw_rate: yawRate, road_half_width: half_width },
    ...{ gust_force_low: Math.abs(gust), gust_force_least_sign: side, gust_force_greatest_sign: side },
  };
  task.start(state, episode, own, { ...task.new_uniforms(), u0: 0.5, u1: 0.5, u2: 1, u3: 1 }, car, rules, settings);
  return { state, episode, own, settings };
}

// An episode of the environment on its way: columns by name, a row for each control step; at its end how it ended.
export class Run {
  constructor(world, who, sideslip, yawRate) {
    Object.assign(this, { world, driver: who, over: false, end: "", settledAfter: null });
    Object.assign(this, started(world, sideslip, yawRate));
    this.observation = world.task.new_observation();
    this.outcome = world.task.new_outcome();
    this.action = world.task.new_action();
    this.columns = Object.fromEntries(["time", "sideslip", ...Object.keys(this.state)].map((name) => [name, []]));
    who.reset();
    this.remember();
  }

  get time() {
    return this.episode.steps * this.world.rules.control_timestep;
  }

  remember() {
    for (const [name, value] of Object.entries(this.state)) this.columns[name].push(value);
    this.columns.time.push(this.time);
    this.columns.sideslip.push(sideslipOf(this.state, this.world.car));
  }

  step() {
    const { task, car, scale, rules } = this.world, { state, episode, own, settings, observation, outcome, action } = this;
    task.observe(observation, state, episode, own, scale, car, rules, settings);
    [action.front, action.rear] = this.driver.act(Object.values(observation), this).map(Math.fround);
    task.step(state, episode, own, outcome, state, episode, own, action, car, rules, settings);
    this.remember();
    this.over = outcome.end !== 0 || episode.steps >= task.step_limit;
    if (!this.over) return;
    this.end = task.end_words[outcome.end];
    const steady = outcome.end === 0 && episode.settled_steps >= task.steps_to_settle;
    this.settledAfter = steady ? (episode.steps - episode.settled_steps) * rules.control_timestep : null;
  }

  until(time) {
    while (!this.over && this.time < time - 1e-9) this.step();
    return this;
  }
}

// A whole episode.
export const run = (world, who, sideslip, yawRate) => new Run(world, who, sideslip, yawRate).until(Infinity);

// What sideslip means: V / U.
const sideslipOf = (state, car) => state.lateral_velocity / car.speed;

// Without steering: [[sideslip, yaw rate], ...] from a start, and whether it comes back to straight running, which is
// `stable` or not: near it an orbit may pass by.
export function orbit(world, stable, box, sideslip, yawRate, seconds) {
  const { task, car, rules } = world;
  const { state, episode, own, settings } = started({ ...world, gust: 0 }, sideslip, yawRate);
  const timestep = rules.control_timestep / rules.substeps, begun = task.new_begun();
  const points = [[sideslipOf(state, car), state.yaw_rate]];
  let inside = true, settled = false;
  for (let n = 1; n * timestep <= seconds && inside && !settled; n++) {
    task.advance(state, state, episode, own, begun, 0, car, rules, settings);
    if (n % rules.substeps) continue;
    const x = sideslipOf(state, car), y = state.yaw_rate;
    points.push([x, y]);
    inside = Math.abs(x) < 1.3 * box.sideslip && Math.abs(y) < 1.3 * box.yawRate;
    settled = stable && Math.abs(x) < 0.01 * box.sideslip && Math.abs(y) < 0.01 * box.yawRate;
  }
  return { points, settled };
}

// From straight running, the wheels of one axle turned by an angle at once: columns by name.
export function stepResponse(world, axle, angle, seconds) {
  const { task, car } = world, rules = { ...world.rules, substeps: FINE * world.rules.substeps };
  const { state, episode, own, settings } = started({ ...world, gust: 0 }, 0, 0);
  const timestep = rules.control_timestep / rules.substeps, begun = task.new_begun(), forces = task.new_axle_forces();
  state[`${axle}_steer`] = begun[`${axle}_steer_command`] = angle;
  const found = { time: [], lateral_acceleration: [], yaw_rate: [] };
  for (let n = 0; n * timestep <= seconds; n++) {
    task.axles(forces, state, car);
    found.time.push(n * timestep);
    found.lateral_acceleration.push(forces.lateral_acceleration);
    found.yaw_rate.push(state.yaw_rate);
    task.advance(state, state, episode, own, begun, 0, car, rules, settings);
  }
  return found;
}

// Seconds until a response that starts one way goes the other; 0 if it does not.
export function wrongWay({ time, lateral_acceleration: values }) {
  const place = values.findIndex((value) => value * values[0] < 0);
  return place > 0 ? time[place] : 0;
}

// Starts on a grid of so many by so many: [[sideslip, yaw rate], ...].
export function grid(box, count) {
  const at = (n, most) => ((2 * n) / (count - 1) - 1) * most;
  const places = [...Array(count).keys()];
  return places.flatMap((i) => places.map((k) => [at(i, box.sideslip), at(k, box.yawRate)]));
}
