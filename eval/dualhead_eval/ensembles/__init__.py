"""Disagreement scores of ensembles, and ensembles as gates."""

from dualhead_eval.ensembles.scores import vfd_score

__all__ = ["vfd_score"]
