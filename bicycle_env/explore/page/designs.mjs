// What is designed for a car and a speed: from the page's data for the presets, of others asked of the server.
import { changes, isChanged } from "./car.mjs";
import { actuatorsOf, isActuatorChanged } from "./choices.mjs";
import { LAWS } from "./drivers.mjs";
import { ask } from "./server.mjs";

export class Designs {
  // `arrived(entry)` is called when an answer is there, or that there is none.
  constructor(data, arrived) {
    Object.assign(this, { data, arrived, entries: new Map() });
  }

  // { found }, or { pending }, or { why } not, or nothing where nobody can be asked. The laws of the rear wheels know
  // no actuators.
  of(chosen, point, name) {
    const asPreset = !isChanged(chosen) && (LAWS.includes(name) || !isActuatorChanged(this.data, chosen));
    const found = asPreset ? point.designs?.[name] : undefined;
    if (found || !this.data.served) return { found };
    const [policy, steer = "both"] = name.split(" ");
    const own = Object.entries(actuatorsOf(chosen)).map(([axle, { rate_limit, ...others }]) => [`${axle}_actuator`, others]);
    const question = { ask: "design", vehicle: chosen.vehicle, changes: changes(this.data, chosen), speed: point.metres_per_second };
    return this.entry({ ...question, policy, steer, ...Object.fromEntries(own) });
  }

  // What had no answer may be asked again.
  forget() {
    for (const [key, { why }] of this.entries) if (why) this.entries.delete(key);
  }

  entry(question) {
    const key = JSON.stringify(question);
    if (!this.entries.has(key)) {
      const mine = { pending: true };
      if (this.entries.size > 200) this.entries.clear();
      this.entries.set(key, mine);
      ask(question)
        .then((found) => Object.assign(mine, { found }), (error) => Object.assign(mine, { why: error.message }))
        .finally(() => {
          mine.pending = false;
          this.arrived(mine);
        });
    }
    return this.entries.get(key);
  }
}
