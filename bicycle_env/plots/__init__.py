"""Figures: of one's own runs, and of a car's analysis. They need matplotlib, of the extra ``analysis``.

Every function returns a ``matplotlib.figure.Figure``; ``save(figure, path)`` writes it as PNG.
"""

from bicycle_env.plots.episode import episode
from bicycle_env.plots.linear import bode, root_locus, stability_map
from bicycle_env.plots.phase import phase_plane
from bicycle_env.plots.responses import WrongWay, step_response, step_responses, wrong_way
from bicycle_env.plots.steady_turns import steady_turns
from bicycle_env.plots.style import LineStyle, line_style, new_figure, png, save, speed_in_words

__all__ = [
    "LineStyle",
    "WrongWay",
    "bode",
    "episode",
    "line_style",
    "new_figure",
    "phase_plane",
    "png",
    "root_locus",
    "save",
    "speed_in_words",
    "stability_map",
    "steady_turns",
    "step_response",
    "step_responses",
    "wrong_way",
]
