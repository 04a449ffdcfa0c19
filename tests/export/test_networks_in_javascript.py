"""The JavaScript class of a network reads a policy's own files, as Python does; what is damaged is a sentence."""

import hashlib
import json
import shutil
import subprocess

import numpy as np
import pytest

from bicycle_env import load_policy
from bicycle_env.control import Network
from bicycle_env.export import export_policy
from bicycle_env.files import pack_arrays

NODE = shutil.which("node")
pytestmark = pytest.mark.skipif(NODE is None, reason="no node here")
SCRIPT = """
import { Network, read } from "./bicycle_policy.mjs";
import * as fs from "node:fs";
const { cases, observations } = JSON.parse(fs.readFileSync("cases.json"));
const found = [];
for (const files of cases) {
  try {
    const bytesOf = (path) => new Uint8Array(fs.readFileSync(path));
    const network = new Network(await read(files.map(([name, path]) => ({ name, bytes: bytesOf(path) }))));
    found.push(observations.map((one) => network.act(one)));
  } catch (error) {
    found.push(error.message);
  }
}
console.log(JSON.stringify(found));
"""


def network():
    draws = np.random.default_rng(5)
    layers = [(draws.standard_normal(shape).astype(np.float32), np.zeros(shape[0], np.float32)) for shape in SHAPES]
    names = load_policy("BicycleStab-v0").description["observation_names"]
    told = {"env_id": "BicycleStab-v0", "observation_names": names, "hold": 2, "history": 3, "mirror": [-1] * 8}
    return Network(layers, "relu", "tanh", told)


SHAPES = ((12, 24), (2, 12))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    found = tmp_path_factory.mktemp("policies")
    export_policy(load_policy("BicycleStab-v0"), "js", found)
    network().save(found)
    (found / "own").mkdir()
    export_policy(network(), "js", found / "own")
    (found / "read.mjs").write_text(SCRIPT)
    return found


def read(folder, cases, observations=()):
    content = {"cases": cases, "observations": [list(map(float, row)) for row in observations]}
    (folder / "cases.json").write_text(json.dumps(content))
    done = subprocess.run([NODE, "read.mjs"], cwd=folder, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_it_acts_as_python_does(folder):
    observations = np.random.default_rng(6).standard_normal((5, 8)).astype(np.float32)
    policy = network()
    wanted = [policy.act(row) for row in observations]
    pair = [["policy.json", "policy.json"], ["policy.safetensors", "policy.safetensors"]]
    module = [["mine.mjs", "own/bicycle_policy.mjs"]]
    for found in read(folder, [pair, pair[::-1], module], observations):
        np.testing.assert_allclose(found, wanted, atol=2e-5)


def packed(told, arrays, **changes):
    content = pack_arrays(arrays)
    return json.dumps({**told, "weights_sha256": hashlib.sha256(content).hexdigest(), **changes}).encode(), content


def damaged():
    """By what is said of it: (policy.json, policy.safetensors)."""
    policy = network()
    told, arrays = policy.description, policy.arrays()
    good, weights = packed(told, arrays)
    cut = weights[:-4]
    nan = {**arrays, "layer1.bias": np.array([np.nan, 0.0], np.float32)}
    double = {**arrays, "layer1.bias": np.zeros(2)}
    narrow = {**arrays, "layer0.weight": arrays["layer0.weight"][:, :23].copy()}
    long = (1 << 40).to_bytes(8, "little") + weights[8:]

    def of(content):
        return json.dumps({**told, "weights_sha256": hashlib.sha256(content).hexdigest()}).encode()

    return {
        "it is no JSON": (b"{", weights),
        "must hold a table": (b"[]", weights),
        "is not a bicycle-env policy": (packed(told, arrays, format="another")[0], weights),
        "of version 1 or 2": (packed(told, arrays, version=3)[0], weights),
        "does not belong to this": (good, cut),
        "no safetensors file": (of(cut), cut),
        "is damaged: it is no safetensors": (of(long), long),
        "of single precision": packed(told, double),
        "are not finite": packed(told, nan),
        "the layers that policy.json announces": packed(told, narrow),
        "says nothing of its layers": packed(told, arrays, layers=None),
        "more layers than": packed(told, {**arrays, "layer2.bias": np.zeros(1, np.float32)}),
        "activation must be": packed(told, arrays, activation="__proto__"),
        "output must be": packed(told, arrays, output="relu"),
        "hold and history": packed(told, arrays, hold=0),
        "mirror must be": packed(told, arrays, mirror=[0] * 8),
        "does not fit its input": packed(told, arrays, history=2),
        "list of names": packed(told, arrays, observation_names="names"),
    }


def test_what_is_damaged_is_a_sentence(folder):
    cases, wanted = [], []
    for k, (words, pair) in enumerate(damaged().items()):
        for name, content in zip(("json", "safetensors"), pair, strict=True):
            (folder / f"bad{k}.{name}").write_bytes(content)
        cases.append([[f"policy.{name}", f"bad{k}.{name}"] for name in ("json", "safetensors")])
        wanted.append(words)
    for name, words in (("archive.zip", "archives and pickles"), ("policy.json", "half of a policy")):
        cases.append([[name, "policy.json"]])
        wanted.append(words)
    (folder / "broken.json").write_text("{broken")
    cases.append([["policy.json", "broken.json"]])
    wanted.append("policy.json is damaged: it is no JSON")
    (folder / "code.mjs").write_text("import 'fs';\nexport const exported = process.exit(1);\n")
    cases += [[["code.mjs", "code.mjs"]], [["read.mjs", "read.mjs"]], []]
    wanted += ["it is no JSON", "no policy that bicycle-env export wrote", "nothing is neither"]
    for words, found in zip(wanted, read(folder, cases), strict=True):
        assert isinstance(found, str), words
        assert words in found
        assert "\n" not in found
        assert found.endswith(".")
