"""A tire law of one's own: Dugoff's, with a peak that the load gives.

    python examples/my_tire.py         # its curve beside the package's laws: runs/my_tire.png

H. Dugoff, P. S. Fancher, L. Segel, SAE 700377 (1970), here without longitudinal slip: F = -C tan(alpha) f(lambda),
lambda = mu Fz / (2 C |tan(alpha)|), f = lambda (2 - lambda) below 1, else 1.
"""

import dataclasses

from bicycle_env.physics.tires import Tire


@dataclasses.dataclass(frozen=True)
class Dugoff(Tire):
    """Linear up to half of the peak force, then bending towards it."""

    def law(self, xp):
        def dugoff(slip_angle, cornering_stiffness, peak_force):
            # |alpha| instead of tan(alpha): slip angles are small where it is not saturated
            linear = cornering_stiffness * abs(slip_angle)
            share = xp.minimum(peak_force / (2.0 * xp.maximum(linear, 1e-9)), 1.0)
            force = linear * share * (2.0 - share)
            return xp.where(slip_angle > 0.0, -force, force)

        return dugoff


if __name__ == "__main__":
    import gymnasium as gym
    import numpy as np

    import bicycle_env
    from bicycle_env import control, plots, tires

    degrees = np.linspace(0.0, 12.0, 200)
    figure = plots.style.new_figure(7, 4.5, "Lateral force over slip angle, 100 kN/rad and 4 kN")
    axes = figure.subplots()
    for name, tire in {"Dugoff (own)": Dugoff(), "Fiala": tires.Fiala(), "tanh": tires.Tanh()}.items():
        axes.plot(degrees, [-1e-3 * tire.lateral_force(np.radians(x), 1e5, 4e3) for x in degrees], label=name)
    axes.set(xlabel="slip angle [deg]", ylabel="lateral force [kN]")
    axes.legend()
    plots.save(figure, "runs/my_tire.png")
    env = gym.make("BicycleStab-v0", tire=Dugoff(), vehicle=bicycle_env.vehicles["oversteer"]).unwrapped
    policy, (observation, _) = control.make("lqr", env), env.reset(seed=1)
    for _ in range(400):
        observation, *_ = env.step(policy.act(observation))
        if env.end:
            break
    print(f"LQR on it: {env.end or 'still running after 8 s'}; runs/my_tire.png")
