"""Residual terms of the fast solver, one per file, each with its Jacobian.

Terms on points give rows per keypoint: residuals (B, 21, c) and derivatives by the keypoint (B, 21, c, 3).
Terms on the pose give rows per finger: residuals (B, 5, c) and derivatives by the finger's nine anatomical
angles (B, 5, c, 9), in the order of `skeleton.FINGERS`, joints outwards, (twist, spread, bend) each.
All are divided by what they are expected to be (their sigma), so that costs add up. NumPy, in
double precision.
"""
