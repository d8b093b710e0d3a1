"""Correction of the detector's landmarks: where it errs, how much, and when it names the wrong side. A line
here turns numbers into numbers with NumPy, and sees no picture.

One small network (`network`), trained on painted pictures of the open hand only
(scripts/train_landmarks.py at commit 2ca2c99). docs/method.md has its training data and its gain.
"""
