// The form: its sliders and lists, and what they say of what is chosen.
import { isChanged, PARTS, PERCENT, speedInWords, stabilityInWords } from "./car.mjs";
import { ACTUATOR_NAMES, ACTUATORS, AREA, AXLES, behindFor, ending, EXPLAINED, hasRear, NUMBERS, OTHERS, SIDES, STEER, usualActuators, WHO } from "./choices.mjs";
import { MANOEUVRES } from "./drivers.mjs";

export const at = (id) => document.getElementById(id);
export const CHOICES = ["vehicle", "tire", "left", "right", "left_rear", "right_rear", "steer", "area"];
export const SLIDERS = ["point", "friction", "gust", "angle", "relaxation_length", ...ACTUATOR_NAMES, ...Object.keys(PARTS)];
export const LETTERS = { left: "A", right: "B" };
const TIRES = { linear: "linear (never slides)", tanh: "tanh (smooth)", fiala: "Fiala (brush model)", magic_formula: "Magic Formula" };

// What is there already is not written again: each writing costs the browser a layout.
const put = (id, words) => {
  if (at(id).textContent !== words) at(id).textContent = words;
};
const say = (id, words) => {
  put(`${id}_words`, words);
  at(id).setAttribute("aria-valuetext", words);
};

const fill = (select, words) => {
  const key = Object.keys(words).join();
  if (select.dataset.words === key) return;
  select.dataset.words = key;
  select.replaceChildren(...Object.entries(words).map(([value, text]) => new Option(text, value)));
};

function slider(name, words, range, into) {
  const label = document.createElement("label"), output = document.createElement("output"), made = document.createElement("input");
  Object.assign(output, { id: `${name}_words` });
  Object.assign(made, { id: name, type: "range", ...range });
  label.append(`${words} `, output, made);
  at(into).append(label);
}

export function build(data) {
  const unstable = (critical) => (critical === null ? "stable at every speed" : `unstable above ${(3.6 * critical).toFixed(0)} km/h`);
  fill(at("vehicle"), Object.fromEntries(Object.entries(data.presets).map(([name, preset]) => [name, `${name}: ${unstable(preset.critical_speed)}`])));
  fill(at("tire"), Object.fromEntries(data.tires.map((tire) => [tire, TIRES[tire] ?? tire.replaceAll("_", " ")])));
  for (const [id, words] of Object.entries({ left: WHO, right: OTHERS, steer: STEER, area: AREA })) fill(at(id), words);
  put("trained", data.trained);
  put("compared", data.compared);
  for (const [part, { words }] of Object.entries(PARTS)) slider(part, words, { min: PERCENT.least, max: PERCENT.most, step: 1 }, "parts");
  for (const axle of AXLES) {
    for (const [field, { words, least, most, step }] of Object.entries(ACTUATORS)) {
      slider(`${axle}_${field}`, `${axle === "front" ? "Front" : "Rear"} ${words}`, { min: least, max: most, step }, "actuators");
    }
  }
}

// Whether tires and actuators lag as usual.
export const isUsual = (data, chosen) => chosen.relaxation_length === 0 &&
  Object.entries(usualActuators(data)).every(([name, value]) => chosen[name] === value);

function showCar({ data, chosen, shown }) {
  const { point, body, straight } = shown, heading = speedInWords(data, point.metres_per_second, straight.critical_speed);
  at("point").max = shown.points.length - 1;
  for (const name of [...CHOICES, ...SLIDERS]) if (at(name).value !== String(chosen[name])) at(name).value = chosen[name];
  for (const name of ["sideslip", "yaw_rate"]) {
    if (document.activeElement !== at(name)) at(name).value = Number(chosen[name].toFixed(2));
  }
  for (const [part, { unit, per, digits }] of Object.entries(PARTS)) say(part, `${(body[part] / per).toFixed(digits)} ${unit}`);
  for (const name of ACTUATOR_NAMES) say(name, `${chosen[name]} ${ACTUATORS[name.slice(name.indexOf("_") + 1)].unit}`);
  at("as_preset").disabled = !isChanged(chosen);
  at("usual_actuators").disabled = isUsual(data, chosen);
  put("source", isChanged(chosen)
    ? `Changed from the preset ${chosen.vehicle}: what the list says of it holds no more.`
    : data.presets[chosen.vehicle].source.replaceAll("`", ""));
  say("point", heading);
  say("friction", `${chosen.friction}${chosen.friction < 0.25 ? " (ice)" : chosen.friction < 0.5 ? " (snow)" : ""}`);
  say("gust", chosen.gust ? `${Math.abs(chosen.gust)} N to the ${chosen.gust > 0 ? "left" : "right"}` : "none");
  say("relaxation_length", chosen.relaxation_length ? `${chosen.relaxation_length} m` : "none: they answer at once");
  put("here", `${heading}.`);
  put("sentence", stabilityInWords(data, straight));
  at("at_once").hidden = chosen.relaxation_length === 0;
}

function showDrivers({ chosen, file }) {
  const words = SIDES.map((side) => chosen[side]);
  at("lqr").hidden = !words.includes("lqr");
  at("trained").hidden = at("compared").hidden = !words.includes("policy");
  at("by_hand").hidden = at("hands").hidden = chosen.left !== "you";
  at("policy_file").hidden = !words.includes("file");
  put("file_name", file ? `At the wheel: ${file.name}.` : "");
  for (const side of SIDES) {
    const rear = `${side}_rear`;
    at(`${rear}_choice`).hidden = !hasRear(chosen, side);
    fill(at(rear), behindFor(chosen[side]));
    at(rear).value = chosen[rear];
    put(`${rear}_words`, hasRear(chosen, side) ? EXPLAINED[chosen[rear]] : "");
  }
  const isScripted = words.some((word) => word in MANOEUVRES) && chosen.steer !== "rear";
  at("manoeuvre").hidden = !isScripted;
  say("angle", chosen.angle ? `${Math.abs(chosen.angle)} deg to the ${chosen.angle > 0 ? "left" : "right"}` : "not at all");
  at("straight").disabled = chosen.sideslip === 0 && chosen.yaw_rate === 0 && chosen.area === "field";
}

// `page`: { data, chosen, shown, complaints, file, python, duration }.
export function show(page) {
  const { chosen, shown, complaints } = page;
  showDrivers(page);
  showCar(page);
  at("recoverable").checked = chosen.recoverable === "on";
  for (const side of SIDES) put(`ending_${side}`, `Car ${LETTERS[side]}, ${shown[side].who}: ${ending(page.data, shown[side], chosen.area)}.`);
  at("complaint").hidden = complaints.length === 0;
  put("complaint", complaints.join(" "));
  put("python", page.python);
  put("copied", "");
  at("time").max = page.duration;
}

// What is wrong with a number of the start in its field, or "".
export function complaintOf(name) {
  const value = at(name).valueAsNumber, { least, most, words } = NUMBERS[name];
  return value >= least && value <= most ? "" : `The start's ${words} must be a number in ${least} to ${most}.`;
}
