"""A policy written out: LQR and other linear controllers as a matrix, trained networks as arrays; single precision."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bicycle_env.backends.trace import TRACE, TRACE_FLOAT32, named, program
from bicycle_env.control.lqr import StateFeedback
from bicycle_env.control.network import BASE, Network
from bicycle_env.export.c_source import C, build_line, comment
from bicycle_env.export.javascript import JAVASCRIPT
from bicycle_env.export.source import Language, lines

EPISODES, CALLS = 3, 40
"""Of the test vectors."""
NETWORK = Path(__file__).parent / "network.mjs"
"""The class that runs a network in JavaScript, and what reads one from files; tanh is added to it."""
TOLERANCE = 2e-5
"""Of the test: sums of single precision in another order."""


@dataclasses.dataclass(frozen=True)
class FloatLanguage(Language):
    """C's float."""

    def number(self, value: float) -> str:
        digits = str(np.float32(value)) + "f"
        return f"({digits})" if digits.startswith("-") else digits


C_FLOAT = FloatLanguage(
    **{
        **vars(C),
        "size": "fabsf({})",
        "floor": "floorf({})",
        "root": "sqrtf({})",
        "declaration": "const float {name} = {value};",
    }
)


@dataclasses.dataclass(frozen=True)
class Layers:
    """What any of these policies is: see ``control.Network``."""

    what: str
    layers: tuple[tuple[NDArray[np.float32], NDArray[np.float32]], ...]
    """(weight (out, in), bias (out,))."""
    activation: str
    output: str
    names: tuple[str, ...]
    """Of the observation's entries."""
    hold: int = 1
    history: int = 1
    mirror: tuple[int, ...] | None = None
    env_id: str = ""
    """Of a network: what it was trained for."""


def layers_of(policy: Any, names: Any = None) -> Layers:
    """Of a controller; `names`: of the observation's entries, where it does not know them.

    Raises:
        ValueError: a controller that is neither linear in the observation nor a network.
    """
    if isinstance(policy, Network):
        told, arrays = policy.description, policy.arrays()
        if BASE in told:
            raise ValueError(
                f"the policy cannot be written out: it is added to the actions of {told[BASE]['controller']!r}"
            )
        count = len(arrays) // 2
        return Layers(
            f"a network trained for {told.get('env_id', 'an unknown id')}",
            tuple((arrays[f"layer{k}.weight"], arrays[f"layer{k}.bias"]) for k in range(count)),
            told["activation"],
            told["output"],
            tuple(told["observation_names"]),
            told.get("hold", 1),
            told.get("history", 1),
            told.get("mirror"),
            told.get("env_id", ""),
        )
    if isinstance(policy, StateFeedback):
        matrix = np.ascontiguousarray(policy.matrix.T, np.float32)
        bias = np.zeros(len(matrix), np.float32)
        return Layers(f"the controller {policy.name}", ((matrix, bias),), "relu", "clip", tuple(names))
    raise ValueError(
        f"policy {policy.name!r} cannot be written out: only networks, and controllers that are a matrix (lqr, "
        "lqr-continuous, pole-placement)"
    )


def files(policy: Any, language: str, names: Any = None, name: str = "bicycle_policy") -> dict[str, str]:
    """By name; `language`: "c" or "js". ValueError as :func:`layers_of`."""
    found = layers_of(policy, names)
    vectors = _vectors(policy, found)
    if language == "js":
        return {f"{name}.mjs": _javascript(found, name), f"{name}_test.mjs": _javascript_test(name, vectors)}
    return {
        f"{name}.h": _header(found, name),
        f"{name}.c": _source(found, name),
        f"{name}_test.c": _test(found, name, vectors),
    }


def javascript_module(policy: Any, name: str) -> str:
    """A network alone, without its test. ValueError as :func:`layers_of`."""
    return _javascript(layers_of(policy), name)


def _vectors(policy: Any, found: Layers) -> list[list[tuple[list[float], list[float]]]]:
    """Episodes of (observation, the policy's action)."""
    draws, episodes = np.random.default_rng(14), []
    for k in range(EPISODES):
        policy.reset()
        size = 0.3 * (k + 1)
        observations = np.clip(size * draws.standard_normal((CALLS, len(found.names))), -10.0, 10.0).astype(np.float32)
        episodes.append([(row.tolist(), policy.act(row).tolist()) for row in observations])
    policy.reset()
    return episodes


def _words(found: Layers) -> list[str]:
    shapes = " -> ".join(str(size) for size in (found.layers[0][0].shape[1], *(len(bias) for _, bias in found.layers)))
    words = [
        f"{found.what[0].upper()}{found.what[1:]}, written by `bicycle-env export`: {shapes}, single precision.",
        "The observation's entries, scaled and clipped as the environment gives them:",
        *(f"  {k} {name}" for k, name in enumerate(found.names)),
        "The action: [-1, 1] of each steered axle, front before rear; 1 is the actuator's angle limit.",
    ]
    if found.hold > 1:
        words.append(f"An action is held for {found.hold} calls; call it in every control step all the same.")
    if found.history > 1:
        words.append(f"It sees the observations of its last {found.history} decisions.")
    if found.mirror:
        words.append("Mirror images are answered by mirror images.")
    return words


def _sizes(found: Layers) -> tuple[int, int, int]:
    """Entries of an observation, of what is seen, axles."""
    entries = len(found.names)
    return entries, entries * found.history, len(found.layers[-1][1])


def _header(found: Layers, name: str) -> str:
    entries, seen, axles = _sizes(found)
    guard, words = f"{name.upper()}_H", [*_words(found), f"Check it: {build_line(name)}"]
    return f"""\
{comment(words)}

#ifndef {guard}
#define {guard}

#ifdef __cplusplus
extern "C" {{
#endif

#define {name.upper()}_ENTRIES {entries}
#define {name.upper()}_AXLES {axles}

/* What it remembers: one for each car. */
typedef struct {{
    int calls; /* since the last decision; 0 at the start */
    int started;
    float action[{axles}];
    float seen[{seen}];
}} {name}_memory;

/* Call it when an episode starts. */
void {name}_reset({name}_memory *memory);

void {name}_act({name}_memory *memory, const float observation[{entries}], float action[{axles}]);

#ifdef __cplusplus
}}
#endif
#endif
"""


def _tanh(xp: Any, language: Language) -> tuple[list[str], str]:
    """The lines, and the result, of the package's own tanh x."""
    found = lines(program([xp.tanh(named(("x", "")))]), language, {("x", ""): "x"}, "tanh")
    return found.body, found.results[0]


def _source(found: Layers, name: str) -> str:
    entries, seen, axles = _sizes(found)
    parts = [f'#include "{name}.h"\n\n#include <math.h>\n#include <string.h>']
    for k, (weight, bias) in enumerate(found.layers):
        rows = ",\n".join("    {" + ", ".join(map(C_FLOAT.number, row)) + "}" for row in weight)
        parts.append(f"static const float weight{k}[{len(bias)}][{weight.shape[1]}] = {{\n{rows}\n}};")
        parts.append(f"static const float bias{k}[{len(bias)}] = {{{', '.join(map(C_FLOAT.number, bias))}}};")
    functions = {found.output} | ({found.activation} if len(found.layers) > 1 else set())
    if "tanh" in functions:
        body, result = _tanh(TRACE_FLOAT32, C_FLOAT)
        text = "\n".join(f"    {line}" for line in body)
        parts.append(f"static float own_tanh(float x)\n{{\n{text}\n    return {result};\n}}")
    if "relu" in functions:
        parts.append("static float own_relu(float x)\n{\n    return x > 0.0f ? x : 0.0f;\n}")
    if "clip" in functions:
        parts.append("static float own_clip(float x)\n{\n    return x < -1.0f ? -1.0f : x > 1.0f ? 1.0f : x;\n}")
    calls, given = [], "seen"
    for k, (weight, bias) in enumerate(found.layers):
        last = k == len(found.layers) - 1
        to = "result" if last else f"layer{k}"
        if not last:
            calls.append(f"    float layer{k}[{len(bias)}];")
        value = "sum" if last else f"own_{found.activation}(sum)"
        calls.append(
            f"    for (int i = 0; i < {len(bias)}; i++) {{\n        float sum = bias{k}[i];\n"
            f"        for (int j = 0; j < {weight.shape[1]}; j++)\n            sum += weight{k}[i][j] * {given}[j];\n"
            f"        {to}[i] = {value};\n    }}"
        )
        given = to
    parts.append(f"static void last_layer(const float *seen, float *result)\n{{\n{chr(10).join(calls)}\n}}")
    decided = [f"    float result[{axles}];", "    last_layer(memory->seen, result);"]
    if found.mirror:
        signs = ", ".join(C_FLOAT.number(sign) for sign in found.mirror)
        parts.append(f"static const float mirror[{entries}] = {{{signs}}};")
        decided += [
            f"    float mirrored[{seen}], other[{axles}];",
            f"    for (int j = 0; j < {seen}; j++)\n        mirrored[j] = memory->seen[j] * mirror[j % {entries}];",
            "    last_layer(mirrored, other);",
            f"    for (int i = 0; i < {axles}; i++)\n        result[i] = 0.5f * (result[i] - other[i]);",
        ]
    decided.append(f"    for (int i = 0; i < {axles}; i++)\n        memory->action[i] = own_{found.output}(result[i]);")
    parts.append(f"static void decide({name}_memory *memory)\n{{\n{chr(10).join(decided)}\n}}")
    parts.append(f"void {name}_reset({name}_memory *memory)\n{{\n    memset(memory, 0, sizeof *memory);\n}}")
    parts.append(
        f"""\
void {name}_act({name}_memory *memory, const float observation[{entries}], float action[{axles}])
{{
    if (memory->calls == 0) {{
        for (int k = {found.history - 1}; k > 0; k--)
            memcpy(memory->seen + k * {entries}, memory->started ? memory->seen + (k - 1) * {entries} : observation,
                   {entries} * sizeof(float));
        memcpy(memory->seen, observation, {entries} * sizeof(float));
        memory->started = 1;
        decide(memory);
    }}
    memory->calls = (memory->calls + 1) % {found.hold};
    memcpy(action, memory->action, {axles} * sizeof(float));
}}"""
    )
    return "\n\n".join(parts) + "\n"


def _test(found: Layers, name: str, vectors: Any) -> str:
    entries, _, axles = _sizes(found)
    rows = [
        "    {" + ", ".join(C_FLOAT.number(value) for value in (*observation, *action)) + "},"
        for episode in vectors
        for observation, action in episode
    ]
    return f"""\
/* What the policy does in Python, {EPISODES} episodes of {CALLS} calls. */
#include "{name}.h"

#include <math.h>
#include <stdio.h>

static const float vectors[][{entries + axles}] = {{
{chr(10).join(rows)}
}};

int main(void)
{{
    {name}_memory memory;
    double largest = 0.0;
    for (int k = 0; k < {EPISODES * CALLS}; k++) {{
        float action[{axles}];
        if (k % {CALLS} == 0)
            {name}_reset(&memory);
        {name}_act(&memory, vectors[k], action);
        for (int i = 0; i < {axles}; i++)
            if (!(fabs(action[i] - vectors[k][{entries} + i]) <= largest))
                largest = fabs(action[i] - vectors[k][{entries} + i]);
    }}
    printf("the largest difference of {EPISODES * CALLS} actions to Python's: %.2g\\n", largest);
    return !(largest <= {TOLERANCE});
}}
"""


def _javascript(found: Layers, name: str) -> str:
    body, result = _tanh(TRACE, JAVASCRIPT)
    content = {
        "entries": len(found.names),
        "names": list(found.names),
        "env_id": found.env_id,
        "activation": found.activation,
        "output": found.output,
        "hold": found.hold,
        "history": found.history,
        "mirror": list(found.mirror) if found.mirror else None,
        "layers": [
            {"weight": [list(map(_short, row)) for row in weight], "bias": list(map(_short, bias))}
            for weight, bias in found.layers
        ],
    }
    head = "\n".join(f"// {line}" for line in [*_words(found), f"Check it: node {name}_test.mjs"])
    text = "\n".join(f"  {line}" for line in body)
    return (
        f"{head}\n\n{NETWORK.read_text(encoding='utf-8')}\nfunction tanh(x) {{\n{text}\n  return {result};\n}}\n\n"
        f"export const exported = {json.dumps(content)};\n"
    )


def _short(value: Any) -> float:
    """As few digits as give the same single precision number."""
    return float(str(np.float32(value)))


def _javascript_test(name: str, vectors: Any) -> str:
    rows = [[[*map(_short, observation)], [*map(_short, action)]] for one in vectors for observation, action in one]
    return f"""\
// What the policy does in Python, {EPISODES} episodes of {CALLS} calls.
import {{ exported, Network }} from "./{name}.mjs";

const vectors = {json.dumps(rows)};

const policy = new Network(exported);
let largest = 0;
for (const [k, [observation, wanted]] of vectors.entries()) {{
  if (k % {CALLS} === 0) policy.reset();
  const action = policy.act(observation);
  wanted.forEach((value, i) => {{
    const difference = Math.abs(action[i] - value);
    if (!(difference <= largest)) largest = difference;
  }});
}}
console.log(`the largest difference of ${{vectors.length}} actions to Python's: ${{largest.toPrecision(2)}}`);
process.exitCode = largest <= {TOLERANCE} ? 0 : 1;
"""
