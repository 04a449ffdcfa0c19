"""Figures: of one's own runs, and of a car's analysis. They need ``pip install "bicycle-env[analysis]"``.

Every function returns a ``matplotlib.figure.Figure``; ``save(figure, path)`` writes it as PNG.
"""

from bicycle_env.plots.episode import episode
from bicycle_env.plots.style import LineStyle, png, save, speed_in_words

__all__ = ["LineStyle", "episode", "png", "save", "speed_in_words"]
