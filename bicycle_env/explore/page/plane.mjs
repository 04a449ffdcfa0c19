// What of the phase plane arrives later: orbits, computed here in slices; steady turns and the recoverable set, asked of
// the server.
import { changes, eigenvalues, isChanged } from "./car.mjs";
import { actuatorsOf, AXLES, DEGREE, moduleOf, usualActuators } from "./choices.mjs";
import { ask } from "./server.mjs";
import { grid, orbit } from "./simulation.mjs";
import { BOX } from "./views.mjs";

const GRID = 9, SECONDS = 4, SLICE = 12; // of the orbits; ms in which nothing else is done
const QUIET = 350; // ms without a change, after which the server is asked
export const known = { flow: null, asked: { portrait: null, recoverable: null } };
let waiting = null, timer = 0;

// Orbits depend on the car, not on the start.
export const orbitsKey = ({ body, point }, chosen) =>
  JSON.stringify([body, moduleOf(chosen), chosen.relaxation_length, point.metres_per_second, chosen.friction]);

// Only where they have changed. `done()` when all are there.
export function computeOrbits(shown, chosen, done) {
  const key = orbitsKey(shown, chosen);
  if (known.flow?.key === key) return;
  known.flow = { key, found: [] };
  const mine = known.flow, { world } = shown;
  const box = { sideslip: BOX.sideslip * DEGREE, yawRate: BOX.yaw_rate * DEGREE };
  const stable = eigenvalues(shown.straight).every(([real]) => real < 0), left = grid(box, GRID), found = [];
  const some = () => {
    if (known.flow !== mine) return;
    for (const until = performance.now() + SLICE; left.length && performance.now() < until; ) {
      found.push(orbit(world, stable, box, ...left.pop(), SECONDS));
    }
    if (left.length) setTimeout(some);
    else done(Object.assign(mine, { found }));
  };
  setTimeout(some);
}

// Of a preset as first shown, without a server, they are in the page's data. `say(words, busy)`, `done()`.
export function askForPlane(data, shown, chosen, say, done) {
  const about = { vehicle: chosen.vehicle, changes: changes(data, chosen), speed: shown.point.metres_per_second };
  const road = { tire: chosen.tire, friction: chosen.friction }, actuators = actuatorsOf(chosen);
  const limits = AXLES.map((axle) => actuators[axle].angle_limit);
  const key = JSON.stringify([about, road, chosen.steer, limits, chosen.recoverable]);
  if (known.asked.key === key) return;
  clearTimeout(timer);
  waiting?.abort();
  const mine = { key, portrait: null, recoverable: null }, wants = chosen.recoverable === "on";
  known.asked = mine;
  if (!data.served) {
    const { exported } = data.presets[chosen.vehicle], as = usualActuators(data);
    const usual = !isChanged(chosen) && chosen.tire === "fiala" && chosen.friction === 1;
    const usualLimits = AXLES.every((axle) => chosen[`${axle}_angle_limit`] === as[`${axle}_angle_limit`]);
    if (usual && exported && exported.metres_per_second === about.speed) {
      mine.portrait = exported.portrait;
      if (wants && usualLimits && chosen.steer === "both") mine.recoverable = exported.recoverable;
    }
    const whole = mine.portrait && (mine.recoverable || !wants);
    say(whole ? "" : "Steady turns and the green set of other cars, speeds, roads and steering are computed by Python: start “bicycle-env explore” on your machine.");
    return;
  }
  waiting = new AbortController();
  const { signal } = waiting;
  say("looking for steady turns", true);
  timer = setTimeout(async () => {
    try {
      mine.portrait = await ask({ ask: "portrait", ...about, ...road }, signal);
      if (known.asked !== mine) return;
      done();
      if (wants) {
        say("computing from where some steering saves the car", true);
        const own = AXLES.map((axle) => [`${axle}_actuator`, { angle_limit: actuators[axle].angle_limit, time_constant: data.actuators[axle].time_constant }]);
        mine.recoverable = await ask({ ask: "recoverable", ...about, ...road, steer: chosen.steer, ...Object.fromEntries(own) }, signal);
      }
      const whole = mine.portrait && (mine.recoverable || !wants);
      if (known.asked === mine) say(whole ? "" : "Another page has asked in between: change something here to ask again.");
    } catch (error) {
      if (known.asked === mine) say(error.message);
    }
    if (known.asked === mine) done();
  }, QUIET);
}
