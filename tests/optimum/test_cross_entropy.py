"""A start's search finds the top of a smooth hill, alone or among others."""

from __future__ import annotations

import numpy as np

from bicycle_env.optimum.cross_entropy import StartSearch, search_each

TOPS = {3: np.array([0.5, -0.2]), 8: np.array([0.9, 0.9]), 5: np.array([-0.4, 0.0])}


def searched(starts, batch, enough=-1e-4):
    best, sizes = dict.fromkeys(starts, (-np.inf, None)), []

    def begin(k):
        return StartSearch(
            np.random.default_rng(k), np.zeros(2), np.ones(2), 1e-4, (-1.0, np.array([1.0, 0.8])), 64, 30
        )

    def iterate(running):
        sizes.append(len(running))
        for k, search in running.items():
            heights = -np.sum((search.draw() - TOPS[k]) ** 2, axis=1)
            top = search.learn(heights)
            best[k] = max(best[k], (heights[top], (search.iteration, *search.drawn[top])))
            search.done = best[k][0] > enough

    search_each(starts, begin, iterate, batch)
    return best, sizes


def test_it_finds_the_top_within_the_bounds():
    best, _ = searched([3, 8, 5], 3)
    for k in (3, 5):
        assert np.allclose(best[k][1][1:], TOPS[k], atol=0.02)
        assert best[k][1][0] < 30
    assert np.allclose(best[8][1][1:], [0.9, 0.8], atol=0.02)  # as far as it may


def test_a_start_does_not_see_the_others():
    together, sizes = searched([3, 8, 5], 2)
    assert max(sizes) == 2
    for k in TOPS:
        alone, own = searched([k], 1)
        assert alone[k] == together[k]
        assert len(own) == (30 if k == 8 else alone[k][1][0])  # no longer than needed


def test_without_starts_nothing_is_tried():
    assert searched([], 2) == ({}, [])
