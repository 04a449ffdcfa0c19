"""Policies as files: what is saved comes back, damage is named, nothing in a file is executed."""

import hashlib
import itertools
import json
import os
import pickle
import struct

import gymnasium as gym
import numpy as np
import pytest

import bicycle_env  # noqa: F401
from bicycle_env.control import Network, load, load_policy
from bicycle_env.control.network import ACTIVATIONS, DESCRIPTION_FILE, OUTPUTS, WEIGHTS_FILE
from bicycle_env.files import FileError, pack_arrays, read_arrays, unpack_arrays

NAMES = [f"entry_{k}" for k in range(5)]


def layers(seed=0, sizes=(5, 8, 6, 2), dtype=np.float32):
    rng = np.random.default_rng(seed)
    return [
        (rng.normal(size=(out, width)).astype(dtype), rng.normal(size=out).astype(dtype))
        for width, out in itertools.pairwise(sizes)
    ]


def network(seed=0, activation="tanh", output="clip", **more):
    description = {"env_id": "BicycleStab-v0", "observation_names": NAMES, **more}
    return Network(layers(seed, (5 * more.get("history", 1), 8, 6, 2)), activation, output, description)


MIRROR = [1, -1, -1, 1, -1]
ACTS = {"hold": 2, "history": 3, "mirror": MIRROR}
"""What a policy's file may say of how it acts."""


@pytest.fixture
def folder(tmp_path):
    network().save(tmp_path)
    return tmp_path


def rewrite(folder, **changes):
    path = folder / DESCRIPTION_FILE
    description = json.loads(path.read_text())
    for key, value in changes.items():
        if value is KeyError:
            del description[key]
        else:
            description[key] = value
    path.write_text(json.dumps(description))


def rewrite_tensors(folder, change):
    tensors = read_arrays(folder / WEIGHTS_FILE)
    change(tensors)
    content = pack_arrays(tensors)
    (folder / WEIGHTS_FILE).write_bytes(content)
    rewrite(folder, weights_sha256=hashlib.sha256(content).hexdigest())


# Acting


@pytest.mark.parametrize("output", OUTPUTS)
@pytest.mark.parametrize("activation", ACTIVATIONS)
def test_the_network_by_hand(activation, output):
    policy = network(activation=activation, output=output)
    x = np.random.default_rng(1).normal(size=5).astype(np.float32)
    act = {"tanh": np.tanh, "relu": lambda v: v * (v > 0)}[activation]
    (w0, b0), (w1, b1), (w2, b2) = ((w.astype(float), b.astype(float)) for w, b in layers())
    raw = w2 @ act(w1 @ act(w0 @ x + b0) + b1) + b2
    expected = np.tanh(raw) if output == "tanh" else np.clip(raw, -1.0, 1.0)
    np.testing.assert_allclose(policy.act(x), expected, rtol=1e-5, atol=1e-6)


def test_a_single_layer_is_affine():
    policy = Network([(np.eye(2, 5) * 0.1, np.array([0.2, -0.3]))], "relu", "clip", {"observation_names": NAMES})
    np.testing.assert_allclose(policy.act(np.array([1.0, 2.0, 3.0, 4.0, 5.0])), [0.3, -0.1], atol=1e-7)


def test_an_action_is_held_and_the_observations_of_the_last_decisions_are_seen():
    policy = network(output="tanh", hold=4, history=3)
    at_once = Network(layers(0, (15, 8, 6, 2)), "tanh", "tanh", {"observation_names": [*NAMES, *NAMES, *NAMES]})
    seen = np.random.default_rng(1).normal(size=(14, 5)).astype(np.float32)
    for _ in range(2):
        actions = [policy.act(observation) for observation in seen]
        for step, decisions in enumerate([[0, 0, 0]] * 4 + [[4, 0, 0]] * 4 + [[8, 4, 0]] * 4 + [[12, 8, 4]] * 2):
            assert np.array_equal(actions[step], at_once.act(seen[decisions].ravel())), step
        policy.reset()


@pytest.mark.parametrize("output", OUTPUTS)
@pytest.mark.parametrize("acts", [{"mirror": MIRROR}, ACTS], ids=["mirror", "all"])
def test_a_mirror_image_is_answered_by_the_mirror_image(acts, output):
    image, actions = np.array(MIRROR, np.float32), []
    original, mirrored = network(output=output, **acts), network(output=output, **acts)
    for observation in 0.1 * np.random.default_rng(2).normal(size=(6, 5)).astype(np.float32):
        actions.append(original.act(observation))
        assert np.array_equal(mirrored.act(observation * image), -actions[-1])
    assert np.all(np.abs(actions) < 1.0)
    assert np.all(np.max(np.abs(actions), axis=0) > 0.01)


def test_the_mirrored_network_by_hand():
    """Half the difference of what the last layer gives, then the output law: the weights are large, so it matters."""
    x, image = np.random.default_rng(3).normal(size=(20, 5)).astype(np.float32), np.array(MIRROR, np.float32)
    (w0, b0), (w1, b1), (w2, b2) = layers()
    raw, other = (
        w2 @ np.tanh(w1 @ np.tanh(w0 @ v.T + b0[:, None]) + b1[:, None]) + b2[:, None] for v in (x, x * image)
    )
    expected = np.clip(0.5 * (raw - other).T, -1.0, 1.0)
    np.testing.assert_allclose(network(mirror=MIRROR).act(x), expected, rtol=1e-5, atol=1e-6)
    assert not np.allclose(expected, 0.5 * (np.clip(raw, -1, 1) - np.clip(other, -1, 1)).T, atol=0.1)


@pytest.mark.parametrize("sizes", [(1, 1), (15, 7, 1), (15, 64, 64, 2)], ids=str)
def test_one_car_of_many_is_driven_as_if_alone_to_the_bit(sizes):
    entries = min(sizes[0], 5)
    description = {"observation_names": NAMES[:entries], "hold": 2, "history": sizes[0] // entries}
    description["mirror"] = [-1] * entries
    rng = np.random.default_rng(4)
    for cars in (2, 37):
        together, *alone = (Network(layers(5, sizes), "tanh", "tanh", description) for _ in range(1 + cars))
        for _ in range(7):
            seen = rng.normal(size=(cars, entries)).astype(np.float32)
            actions = together.act(seen)
            assert np.array_equal(actions, [policy.act(row) for policy, row in zip(alone, seen, strict=True)])
            anew = rng.random(cars) < 0.3
            together.reset(anew)
            for row in np.flatnonzero(anew):
                alone[row].reset()


@pytest.mark.parametrize("acts", [{}, ACTS], ids=["plain", "all"])
def test_no_cars_at_all_have_no_actions(acts):
    assert network(**acts).act(np.zeros((0, 5), np.float32)).shape == (0, 2)


def test_an_observation_of_another_size_is_named():
    with pytest.raises(ValueError, match=r"observation must have 5 entries, or rows of them, got shape \(4, 6\)"):
        network().act(np.zeros((4, 6)))


# There and back


def test_a_policy_is_not_loaded_for_another_environment(tmp_path):
    load_policy("BicycleStab-v0").save(tmp_path)
    load(tmp_path, gym.make("BicycleStab-v0"))
    with pytest.raises(FileError, match="trained for BicycleStab-v0 with 8 observations"):
        load(tmp_path, gym.make("BicycleEvade-v0"))


@pytest.mark.parametrize("output", OUTPUTS)
@pytest.mark.parametrize("activation", ACTIVATIONS)
def test_saved_and_loaded_it_acts_to_the_bit(tmp_path, activation, output):
    policy = network(3, activation, output, origin="seed 17", note="träge")
    policy.save(tmp_path / "new" / "folder")
    back = load(tmp_path / "new" / "folder")
    x = np.random.default_rng(4).normal(size=(100, 5)).astype(np.float32)
    assert np.array_equal(policy.act(x), back.act(x))
    assert not np.array_equal(back.act(x), network(4, activation, output).act(x))
    assert back.description == policy.description
    assert back.description["note"] == "träge"
    assert back.description["layers"] == [[8, 5], [6, 8], [2, 6]]
    assert sorted(os.listdir(tmp_path / "new" / "folder")) == [DESCRIPTION_FILE, WEIGHTS_FILE]


def test_how_it_acts_comes_back_from_the_file(tmp_path):
    policy = network(output="tanh", **ACTS)
    policy.save(tmp_path)
    back = load(tmp_path)
    assert {name: back.description[name] for name in ACTS} == ACTS
    for observation in np.random.default_rng(5).normal(size=(7, 3, 5)).astype(np.float32):
        assert np.array_equal(policy.act(observation), back.act(observation))


def test_a_file_of_version_1_acts_as_it_did(folder):
    rewrite(folder, version=1)
    x = np.random.default_rng(6).normal(size=(9, 5)).astype(np.float32)
    assert np.array_equal(load(folder).act(x), network().act(x))


def test_saving_twice_gives_the_same_bytes(tmp_path):
    network().save(tmp_path / "a")
    load(tmp_path / "a").save(tmp_path / "b")
    for name in (DESCRIPTION_FILE, WEIGHTS_FILE):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes()


def test_weights_of_another_save_are_refused(folder, tmp_path):
    network(7).save(tmp_path / "other")
    (folder / WEIGHTS_FILE).write_bytes((tmp_path / "other" / WEIGHTS_FILE).read_bytes())
    with pytest.raises(ValueError, match="does not belong"):
        load(folder)


def test_the_path_may_be_text(folder):
    assert load(str(folder)).description["env_id"] == "BicycleStab-v0"


def test_loading_never_unpickles(folder, monkeypatch):
    def refused(*_, **__):
        raise AssertionError("unpickled")

    for name in ("load", "loads", "Unpickler"):
        monkeypatch.setattr(pickle, name, refused)
    load(folder)


def test_a_pickle_in_the_place_of_the_weights_is_damage_and_is_not_executed(folder, tmp_path):
    trace = tmp_path / "executed"

    class Bomb:
        def __reduce__(self):
            return open, (str(trace), "w")

    for name in (WEIGHTS_FILE, DESCRIPTION_FILE):
        network().save(folder)
        (folder / name).write_bytes(pickle.dumps(Bomb()))
        with pytest.raises(FileError, match="does not belong" if name == WEIGHTS_FILE else "not JSON"):
            load(folder)
    assert not trace.exists()


# Damage


@pytest.mark.parametrize("name", [DESCRIPTION_FILE, WEIGHTS_FILE])
def test_a_missing_file_is_named(folder, name):
    (folder / name).unlink()
    with pytest.raises(FileNotFoundError, match=f"no {name}"):
        load(folder)


def test_a_missing_folder_is_named(tmp_path):
    with pytest.raises(FileNotFoundError, match="nowhere"):
        load(tmp_path / "nowhere")


@pytest.mark.parametrize("share", [0.0, 0.05, 0.5, 0.95])
@pytest.mark.parametrize("name", [DESCRIPTION_FILE, WEIGHTS_FILE])
def test_a_truncated_file(folder, name, share):
    content = (folder / name).read_bytes()
    (folder / name).write_bytes(content[: int(share * len(content))])
    with pytest.raises(FileError, match=f"^{folder / name}: (not JSON|does not belong)"):
        load(folder)


@pytest.mark.parametrize("content", ["[]", "3", "null", '"text"', "{}"])
def test_a_description_that_is_something_else(folder, content):
    (folder / DESCRIPTION_FILE).write_text(content)
    with pytest.raises(FileError, match=r"must (have the keys|be a table of) format, version"):
        load(folder)


BAD_ACTS = [
    ({"hold": 0}, r"^([^:]*: )?hold must be a whole number in \[1, 1000\], got 0$"),
    ({"hold": 1001}, "hold must be a whole number"),
    ({"hold": 2.0}, "hold must be a whole number"),
    ({"history": -1}, "history must be a whole number in"),
    ({"history": True}, "history must be a whole number in"),
    ({"mirror": [1, -1]}, r"mirror must be \+1 or -1 for each of 5 observations, got \[1, -1\]$"),
    ({"mirror": [1, 1, 0, 1, 1]}, r"mirror must be \+1 or -1 for each of 5"),
    ({"mirror": [1, 1, 2, 1, 1]}, r"mirror\[2\] must be a whole number in \[-1, 1\], got 2"),
    ({"mirror": [1, 1, 0.5, 1, 1]}, r"mirror\[2\] must be a whole number"),
    ({"mirror": "+-+-+"}, "mirror must be a list"),
    ({"mirror": None}, "mirror must be a list"),
    ({"mirror": []}, "mirror must have 1 to"),
]


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        ({"version": 4}, r"version must be a whole number in \[1, 3\], got 4"),
        ({"version": "1"}, "version must be a whole number"),
        ({"version": None}, "version must be"),
        ({"format": "something else"}, "format must be one of 'bicycle-env policy', got 'something else'"),
        ({"format": KeyError}, "must have the keys"),
        ({"layers": KeyError}, "must have the keys"),
        ({"observation_names": KeyError}, "must have the keys"),
        ({"activation": "gelu"}, "activation must be one of 'tanh', 'relu', got 'gelu'"),
        ({"activation": None}, "activation"),
        ({"activation": ["tanh"]}, "activation"),
        ({"activation": {}}, "activation"),
        ({"output": "softmax"}, "output must be one of 'clip', 'tanh', got 'softmax'"),
        ({"output": []}, "output"),
        ({"layers": []}, "layer"),
        ({"layers": [[8, 5], [6, 8], [2, 6], [2, 2]]}, "lacks layers"),
        ({"layers": [[8, 5]] * 4}, "lacks layers"),
        ({"layers": 3}, "layers"),
        ({"layers": None}, "layers"),
        ({"observation_names": ["a", "b"]}, "layer 0.*its input has 2 entries"),
        ({"observation_names": []}, "observation_names must have 1 to"),
        ({"observation_names": 5}, "observation_names"),
        ({"observation_names": None}, "observation_names"),
        ({"observation_names": "abcde"}, "observation_names"),
        ({"observation_names": [1, 2, 3, 4, 5]}, "observation_names"),
        *BAD_ACTS,
        ({"history": 2}, "layer 0 has shapes .* its input has 10 entries"),
    ],
    ids=str,
)
def test_a_description_that_does_not_fit(folder, changes, match):
    rewrite(folder, **changes)
    with pytest.raises(ValueError, match=match):
        load(folder)


def test_a_description_that_announces_other_layers_than_there_are(folder):
    """Fewer layers than the weights hold, or other shapes: not the policy that was saved."""
    rewrite(folder, layers=[[8, 5], [6, 8]])
    with pytest.raises(ValueError, match="layer"):
        load(folder)
    network().save(folder)
    rewrite(folder, layers=[[8, 5], [6, 8], [3, 6]])
    with pytest.raises(ValueError, match="layer"):
        load(folder)


def poison(value):
    def change(tensors):
        tensors["layer1.bias"] = tensors["layer1.bias"].copy()
        tensors["layer1.bias"][2] = value

    return change


def transpose(tensors):
    tensors["layer0.weight"] = np.ascontiguousarray(tensors["layer0.weight"].T)


def shorten(tensors):
    tensors["layer1.bias"] = tensors["layer1.bias"][:-1].copy()


def flatten(tensors):
    tensors["layer1.weight"] = tensors["layer1.weight"].ravel().copy()


def rename(tensors):
    tensors["layer9.weight"] = tensors.pop("layer1.weight")


@pytest.mark.parametrize(
    ("change", "match"),
    [
        (poison(np.nan), "'layer1.bias' has values that are not finite"),
        (poison(np.inf), "'layer1.bias' has values that are not finite"),
        (transpose, "other layers"),
        (shorten, "layer 1 has shapes"),
        (flatten, "other layers"),
        (rename, "lacks layers"),
        (dict.clear, "lacks layers"),
    ],
    ids=["nan", "inf", "transposed", "short bias", "flat", "renamed", "empty"],
)
def test_weights_that_do_not_fit(folder, change, match):
    rewrite_tensors(folder, change)
    with pytest.raises(ValueError, match=match):
        load(folder)


def put(name, content):
    return lambda folder: (folder / name).write_bytes(content)


def instead(name, make):
    def change(folder):
        (folder / name).unlink()
        make(folder / name)

    return change


def sparse(path):
    with path.open("wb") as file:
        file.truncate(3 * 10**9)


def pack(**arrays):
    """Weights that the loader's own writer would not write, with their digest in the description."""

    def change(folder):
        content = pack_arrays({**unpack_arrays((folder / WEIGHTS_FILE).read_bytes(), "x"), **arrays})
        (folder / WEIGHTS_FILE).write_bytes(content)
        rewrite(folder, weights_sha256=hashlib.sha256(content).hexdigest())

    return change


def header(words, body=b""):
    def change(folder):
        content = struct.pack("<Q", len(words)) + words + body
        (folder / WEIGHTS_FILE).write_bytes(content)
        rewrite(folder, weights_sha256=hashlib.sha256(content).hexdigest())

    return change


def describe(**changes):
    return lambda folder: rewrite(folder, **changes)


HOSTILE = [
    (instead(DESCRIPTION_FILE, os.mkdir), "must be a regular file, is a folder"),
    (instead(WEIGHTS_FILE, os.mkdir), "must be a regular file, is a folder"),
    (instead(DESCRIPTION_FILE, os.mkfifo), "must be a regular file, is a FIFO"),
    (instead(WEIGHTS_FILE, os.mkfifo), "must be a regular file, is a FIFO"),
    (instead(DESCRIPTION_FILE, lambda path: path.symlink_to("/dev/zero")), "must be a regular file, is a device"),
    (instead(WEIGHTS_FILE, lambda path: path.symlink_to("/dev/zero")), "must be a regular file, is a device"),
    (instead(DESCRIPTION_FILE, sparse), "must not be larger than 1000000 bytes, has 3000000000"),
    (instead(WEIGHTS_FILE, sparse), "must not be larger than 100000000 bytes, has 3000000000"),
    (put(DESCRIPTION_FILE, b"\xff\xfe\x00\x80"), "not JSON"),
    (put(DESCRIPTION_FILE, b"[" * 100_000), "nested deeper"),
    (put(DESCRIPTION_FILE, b'{"a":' * 100 + b"1" + b"}" * 100), "nested deeper"),
    (put(DESCRIPTION_FILE, b'{"version": 1, "version": 2}'), "'version' stands twice"),
    (put(DESCRIPTION_FILE, b'{"version": ' + b"9" * 5000 + b"}"), "not JSON"),
    (put(WEIGHTS_FILE, struct.pack("<Q", 2**60) + b"{}"), "does not belong"),
    (describe(version=1.0), "version must be a whole number"),
    (describe(version=True), "version must be a whole number"),
    (describe(version=10**30), "version must be a whole number"),
    (describe(extra=float("nan")), "extra must be a finite number"),
    (describe(extra=10**300), "extra must be a number of at most 128 bits"),
    (describe(extra="\ud800"), "extra holds what is no Unicode"),
    (describe(env_id=3), "env_id must be a text"),
    (describe(env_id=["x"]), "env_id must be a text"),
    (describe(env_id="x" * 201), "env_id must have at most 200 characters"),
    (describe(env_keywords=[1]), "env_keywords must be a table"),
    (describe(env_keywords="{}"), "env_keywords must be a table"),
    (describe(weights_sha256=3), "weights_sha256 must be a text"),
    (describe(weights_sha256="0" * 64), "does not belong"),
    (describe(format="\x1b[2J\x1b[31m[/red]"), r"got '\\x1b\[2J\\x1b\[31m\[/red\]'"),
    (describe(activation="\u202ehnat"), r"got '\\u202ehnat'"),
    (describe(activation="y" * 100_000), "activation must be one of"),
    (describe(observation_names=[*NAMES[:4], "x" * 201]), "observation_names.4. must have at most 200 characters"),
    (describe(observation_names=["a", *NAMES]), "layer 0 .*its input has 6 entries"),
    (describe(layers=[[8, 5], [6, 8], [2, True]]), r"layers\[2\]\[1\] must be a whole number"),
    (describe(layers=[[8, 5], [6, 8], [2.0, 6]]), r"layers\[2\]\[0\] must be a whole number"),
    (describe(layers=[[8, 5], [6, 8], [2, -6]]), r"layers\[2\]\[1\] must be a whole number"),
    (describe(layers=[[8, 5], [6, 8], [2, 6, 1]]), r"layers\[2\] must have 2 to 2 entries"),
    (describe(layers=[[8, 5], [6, 8], 2]), r"layers\[2\] must be a list"),
    (describe(layers=[[1, 1]] * 101), "layers must have 1 to 100 entries"),
    (describe(layers=[[10**12, 5]]), r"layers\[0\]\[0\] must be a whole number"),
    (pack(**{"layer3.weight": np.ones((2, 2), np.float32)}), "other layers"),
    (pack(**{"layer0.bias": np.ones(8)}), "must be of dtype F32"),
    (pack(**{"layer0.bias": np.ones(8, np.int64)}), "must be of dtype F32"),
    (pack(**{"layer0.bias": np.ones((8, 1), np.float32)}), "layer 0 has shapes"),
    (pack(**{"layer0.bias": np.float32(1.0)}), "layer 0 has shapes"),
    (header(b""), "the header: not JSON"),
    (header(b"[]"), "the header: the content must be a table"),
    (header(b"[" * 1000), "nested deeper"),
    (header(b'{"layer0.weight": 3}'), "'layer0.weight' must be a table"),
    (
        header(b'{"\\u001b[31m": {"dtype": "F32", "shape": [9], "data_offsets": [0, 4]}}', b"1234"),
        r"'\\x1b\[31m' has 4",
    ),
    (header(b'{"x": {"dtype": "F32", "shape": [4294967296, 4294967296], "data_offsets": [0, 0]}}'), "'x' has 0 bytes"),
]


@pytest.mark.parametrize(("change", "match"), HOSTILE, ids=range(len(HOSTILE)))
def test_a_hostile_policy_is_one_printable_line_that_names_its_file(folder, change, match):
    change(folder)
    with pytest.raises(FileError, match=match) as caught:
        load(folder)
    words = str(caught.value)
    assert words.startswith(str(folder))
    assert words.isprintable()
    assert len(words) < 1000


@pytest.mark.parametrize("name", ["model.zip", "model.pkl", "model.pt"])
def test_archives_and_pickles_are_refused_in_words_and_never_opened(tmp_path, monkeypatch, name):
    path = tmp_path / name
    path.write_bytes(pickle.dumps({}))
    monkeypatch.setattr(os, "open", lambda *_: pytest.fail("opened"))
    with pytest.raises(FileError, match=r"Stable-Baselines3, pickles and \.pt files can hold code"):
        load(path)


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        ((layers(), "sigmoid", "clip"), "activation"),
        ((layers(), "tanh", "none"), "output"),
        (([], "tanh", "clip"), "at least one layer"),
        ((layers(sizes=(4, 2)), "tanh", "clip"), "layer 0"),
        ((layers()[:1] + layers()[2:], "tanh", "clip"), "layer 1"),
    ],
)
def test_the_constructor_refuses_the_same(arguments, match):
    with pytest.raises(ValueError, match=match):
        Network(*arguments, {"observation_names": NAMES})


@pytest.mark.parametrize(("acts", "match"), BAD_ACTS, ids=str)
def test_the_constructor_refuses_the_same_ways_to_act(acts, match):
    with pytest.raises((TypeError, ValueError), match=match) as caught:
        Network(layers(), "tanh", "clip", {"observation_names": NAMES, **acts})
    assert "\n" not in str(caught.value)


# Writing


class KilledError(BaseException):
    """Stands for a signal in the middle of a write."""


def test_a_kill_while_saving_leaves_a_policy_that_loads(folder, monkeypatch):
    x = np.ones(5, np.float32)
    before = load(folder).act(x)

    def killed(*_, **__):
        raise KilledError

    monkeypatch.setattr(os, "replace", killed)
    with pytest.raises(KilledError):
        network(9).save(folder)
    monkeypatch.undo()
    assert np.array_equal(load(folder).act(x), before)
