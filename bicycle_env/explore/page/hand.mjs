// The steering wheel under the arrow keys.
export const TURN = 2; // of the wheel while a key is held, full lock per s
export const RETURN = 4; // back to the middle, once it is let go
const KEYS = { ArrowLeft: 1, a: 1, ArrowRight: -1, d: -1 }; // to the left is positive

export class Hand {
  constructor(timestep) {
    this.timestep = timestep;
    this.held = new Set();
    this.reset();
  }

  reset() {
    this.wheel = 0;
    this.steered = [];
  }

  // Whether it is a key of the wheel's.
  press(key, down) {
    if (!(key in KEYS)) return false;
    if (down) this.held.add(key);
    else this.held.delete(key);
    return true;
  }

  // The action of the next control step, with few digits, so that it can be written down.
  next() {
    const wanted = [...this.held].reduce((sum, key) => sum + KEYS[key], 0), back = RETURN * this.timestep;
    if (wanted) this.wheel = Math.min(Math.max(this.wheel + wanted * TURN * this.timestep, -1), 1);
    else this.wheel -= Math.min(Math.max(this.wheel, -back), back);
    this.steered.push(Number(this.wheel.toFixed(3)));
    return this.steered.at(-1);
  }
}
