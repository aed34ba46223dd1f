"""Levels of the tests of all packages. Limits follow from them and from the degrees of freedom of a test.

Limits of single normal errors are in `features/normal_limits.py`.
"""

from __future__ import annotations

# Probability that correct data pass a test whose decision later data can correct: association and search.
# Origin: definition.
GATE = 0.999
# Probability that correct data pass a test whose decision is final, or moves the whole map: what passes must agree
# well. Origin: definition, the usual level of a test.
STRICT_GATE = 0.95
# Share from which on it is most of them. Origin: definition.
MOST = 0.5
# Observations for a statement that outweigh one against it: doors, glass and people cause some of these at correct
# places. Origin: chosen, three of four; not measured.
SUPPORT_RATIO = 3.0
