"""Numbers of the normal distribution by which medians estimate the spread of errors, hardly affected by outliers."""

from __future__ import annotations

# Median of a squared standard normal variable. Origin: definition, chi-square, 1 dof.
NORMAL_MEDIAN = 0.4549
# Median of the sum of two squared standard normal variables. Origin: definition, chi-square, 2 dof.
PLANE_MEDIAN = 1.3863
# Relative standard error of the median of squared normal variables, times the root of their number: 1 / (2 f(m) m) with
# the median m and the density f. Origin: definition, chi-square, 1 dof.
NORMAL_MEDIAN_ERROR = 2.33
# Standard deviation of a normal variable relative to the median of its absolute value. Origin: definition.
NORMAL_SCALE = 1.4826
