// Files of a policy that were chosen or dropped on the page.
import { read } from "./policy.mjs";

const LARGEST = 100e6; // bytes of one

// { name, parts } of a policy; an Error says in a sentence what is wrong with them.
export async function policyOf(given) {
  if (given.some(({ size }) => size > LARGEST)) throw new Error(`A policy file must not be larger than ${LARGEST / 1e6} MB.`);
  const files = await Promise.all(given.map(async (one) => ({ name: one.name, bytes: new Uint8Array(await one.arrayBuffer()) })));
  return { name: files.map(({ name }) => name).sort()[0], parts: await read(files) };
}

// Of what is dropped: the files, and those of a folder that belong to a policy.
export async function dropped({ items }) {
  const entries = [...items].map((item) => item.webkitGetAsEntry?.()).filter(Boolean);
  const fileOf = (entry) => new Promise((resolve, reject) => entry.file(resolve, reject));
  const inside = (entry) => new Promise((resolve, reject) => entry.createReader().readEntries(resolve, reject));
  const listed = await Promise.all(entries.map(async (entry) =>
    entry.isDirectory ? (await inside(entry)).filter(({ name }) => ["policy.json", "policy.safetensors"].includes(name)) : [entry]));
  return Promise.all(listed.flat().map(fileOf));
}
