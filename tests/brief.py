"""Evaluations for tests that need one, and not its figures: everything is measured, of as little as there can be."""

from __future__ import annotations

from neuroanimator.learn.evaluation.evaluate import EvaluationBudget

BRIEF = EvaluationBudget(runs=2, transitions=80, repeats=1, starts=20, steps=50, rounds=1)
"""A second: most of what a longer one takes goes into simulating finely."""
