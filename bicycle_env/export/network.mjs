const ACTIVATIONS = {
  tanh: (x) => tanh(x),
  relu: (x) => (x > 0 ? x : 0),
  clip: (x) => Math.min(Math.max(x, -1), 1),
};

// A policy with its memory, one for each car: reset() when an episode starts, act(observation) in every control step.
export class Network {
  constructor(description) {
    Object.assign(this, description);
    this.reset();
  }

  reset() {
    this.calls = 0;
    this.seen = null;
    this.action = null;
  }

  act(observation) {
    if (this.calls === 0) {
      const now = Array.from(observation);
      const before = this.seen ?? Array(this.history).fill(now).flat();
      this.seen = [...now, ...before].slice(0, now.length * this.history);
      this.action = this.decided(this.seen).map(ACTIVATIONS[this.output]);
    }
    this.calls = (this.calls + 1) % this.hold;
    return [...this.action];
  }

  decided(seen) {
    const raw = this.lastLayer(seen);
    if (this.mirror === null) return raw;
    const other = this.lastLayer(seen.map((value, k) => value * this.mirror[k % this.entries]));
    return raw.map((value, k) => 0.5 * (value - other[k]));
  }

  lastLayer(seen) {
    return this.layers.reduce((given, { weight, bias }, k) => {
      const activation = k < this.layers.length - 1 ? ACTIVATIONS[this.activation] : (x) => x;
      const found = new Float64Array(weight.length);
      for (let i = 0; i < weight.length; i++) {
        const row = weight[i];
        let sum = bias[i];
        for (let j = 0; j < row.length; j++) sum += row[j] * given[j];
        found[i] = activation(sum);
      }
      return found;
    }, seen);
  }
}

// What a Network is made of, from files [{ name, bytes }]: policy.json with policy.safetensors of a policy's folder, or
// a module like this one. Nothing in them is run. An Error says in a sentence what is wrong with them.
export async function read(files) {
  const ending = (end) => files.find(({ name }) => name.toLowerCase().endsWith(end));
  const [json, weights, module] = [".json", ".safetensors", ".mjs"].map(ending);
  if (module && files.length === 1) return checked(module.name, ofModule(module));
  if (json && weights && files.length === 2) return checked(json.name, await ofFolder(json, weights));
  if (files.length === 1 && (json || weights)) {
    if (json) parsed(json.name, json.bytes);
    throw new Error(`${files[0].name} is half of a policy: policy.json and policy.safetensors are needed together.`);
  }
  const names = files.map(({ name }) => short(name)).join(", ") || "nothing";
  throw new Error(
    "A policy is the files policy.json and policy.safetensors of its folder, or a module that bicycle-env export wrote; " +
      `${names} is neither (archives and pickles can hold code, and are never opened).`,
  );
}

const WIDEST = 100000, MOST_LAYERS = 100, MOST_STEPS = 1000, LARGEST = 100000000;
const short = (value) => String(value).slice(0, 60);
const whole = (value, least, most) => Number.isInteger(value) && value >= least && value <= most;
const isTable = (value) => typeof value === "object" && value !== null && !Array.isArray(value);

function parsed(name, bytes) {
  let found = null;
  try {
    found = JSON.parse(new TextDecoder("utf-8", { fatal: true }).decode(bytes));
  } catch {
    throw new Error(`${name} is damaged: it is no JSON.`);
  }
  if (!isTable(found)) throw new Error(`${name} must hold a table of a policy.`);
  return found;
}

function ofModule({ name, bytes }) {
  const text = new TextDecoder().decode(bytes), start = "\nexport const exported = ";
  const place = text.indexOf(start), end = text.indexOf(";\n", place);
  if (place < 0 || end < 0) throw new Error(`${name} is no policy that bicycle-env export wrote.`);
  return parsed(name, new TextEncoder().encode(text.slice(place + start.length, end)));
}

async function ofFolder({ name, bytes }, weights) {
  const told = parsed(name, bytes);
  if (told.format !== "bicycle-env policy" || !whole(told.version, 1, 2)) {
    throw new Error(`${name} is not a bicycle-env policy of version 1 or 2.`);
  }
  if (globalThis.crypto?.subtle) {
    const digest = new Uint8Array(await crypto.subtle.digest("SHA-256", weights.bytes));
    if (Array.from(digest, (byte) => byte.toString(16).padStart(2, "0")).join("") !== told.weights_sha256) {
      throw new Error(`${weights.name} does not belong to this ${name}, or is damaged.`);
    }
  }
  const arrays = tensors(weights), layers = [];
  if (!Array.isArray(told.layers)) throw new Error(`${name} says nothing of its layers.`);
  for (const [k, shape] of told.layers.entries()) {
    const weight = arrays[`layer${k}.weight`], bias = arrays[`layer${k}.bias`];
    if (!weight || !bias || String(weight.shape) !== String(shape) || bias.shape.length !== 1) {
      throw new Error(`${weights.name} has not the layers that ${name} announces.`);
    }
    const rows = Array.from({ length: shape[0] }, (_, i) => weight.values.slice(i * shape[1], (i + 1) * shape[1]));
    layers.push({ weight: rows, bias: bias.values });
  }
  if (Object.keys(arrays).length !== 2 * layers.length) throw new Error(`${weights.name} has more layers than ${name} announces.`);
  return { ...told, names: told.observation_names, layers };
}

// Arrays of single precision by their names: { shape, values }.
function tensors({ name, bytes }) {
  const damaged = () => new Error(`${name} is damaged: it is no safetensors file of single precision.`);
  if (bytes.length > LARGEST) throw new Error(`${name} must not be larger than ${LARGEST / 1e6} MB.`);
  if (bytes.length < 8) throw damaged();
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  const size = view.getUint32(0, true), data = 8 + size, found = {};
  if (view.getUint32(4, true) !== 0 || data > bytes.length) throw damaged();
  for (const [key, entry] of Object.entries(parsed(name, bytes.subarray(8, data)))) {
    if (key === "__metadata__") continue;
    const { dtype, shape, data_offsets: offsets } = entry ?? {};
    if (dtype !== "F32" || !Array.isArray(shape) || !Array.isArray(offsets)) throw damaged();
    if (![...shape, ...offsets].every((value) => whole(value, 0, LARGEST))) throw damaged();
    const count = shape.reduce((product, length) => product * length, 1);
    if (offsets[1] - offsets[0] !== 4 * count || data + offsets[1] > bytes.length) throw damaged();
    const values = Array.from({ length: count }, (_, k) => view.getFloat32(data + offsets[0] + 4 * k, true));
    found[key] = { shape, values };
  }
  return found;
}

// The parts of a Network alone, each as it must be.
function checked(name, told) {
  const { names, env_id, activation, output, layers, hold = 1, history = 1, mirror = null } = told;
  const refuse = (what) => {
    throw new Error(`${name}: ${what}.`);
  };
  if (!Array.isArray(names) || !whole(names.length, 1, WIDEST) || !names.every((one) => typeof one === "string")) {
    refuse("observation_names must be a list of names");
  }
  if (!["tanh", "relu"].includes(activation)) refuse(`activation must be tanh or relu, got ${short(activation)}`);
  if (!["clip", "tanh"].includes(output)) refuse(`output must be clip or tanh, got ${short(output)}`);
  if (!whole(hold, 1, MOST_STEPS) || !whole(history, 1, MOST_STEPS)) refuse(`hold and history must be whole, 1 to ${MOST_STEPS}`);
  if (mirror !== null && !(Array.isArray(mirror) && mirror.length === names.length && mirror.every((one) => one === 1 || one === -1))) {
    refuse("mirror must be +1 or -1 for each observation");
  }
  if (!Array.isArray(layers) || !whole(layers.length, 1, MOST_LAYERS)) refuse(`there must be 1 to ${MOST_LAYERS} layers`);
  let width = names.length * history;
  for (const [k, layer] of layers.entries()) {
    const { weight, bias } = layer ?? {};
    const fits = Array.isArray(weight) && Array.isArray(bias) && bias.length > 0 && weight.length === bias.length &&
      weight.every((row) => Array.isArray(row) && row.length === width);
    if (!fits) refuse(`layer ${k} does not fit its input of ${width} numbers`);
    if (![...weight.flat(), ...bias].every(Number.isFinite)) refuse(`layer ${k} has values that are not finite`);
    width = bias.length;
  }
  return { entries: names.length, names, env_id: short(env_id ?? ""), activation, output, hold, history, mirror, layers };
}
