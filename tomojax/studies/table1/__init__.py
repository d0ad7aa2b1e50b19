"""Predicts the paper's Table I. The study uses the library as any caller would."""

from tomojax.studies.table1._study import PAPER as PAPER, run as run
