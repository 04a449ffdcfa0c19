"""Workers that are spawned begin with nothing imported: the id names the module that registers it."""

import subprocess
import sys

PROGRAM = """
import sys
import gymnasium as gym
import numpy as np

if __name__ == "__main__":
    env = gym.make_vec("bicycle_env:BicycleStab-v0", 1, "async", vector_kwargs={"context": "spawn"})
    observations, _ = env.reset(seed=3)
    alone = [gym.make("BicycleStab-v0").reset(seed=3)[0]]
    sys.stdout.write(str(np.array_equal(observations, alone)))
    env.close()
"""


def test_the_modules_name_in_the_id_is_enough(tmp_path):
    """As from a notebook: __main__ of the worker has no ``import bicycle_env``."""
    program = tmp_path / "program.py"
    program.write_text(PROGRAM)
    done = subprocess.run([sys.executable, "-W", "error", str(program)], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (0, "True"), done.stderr
