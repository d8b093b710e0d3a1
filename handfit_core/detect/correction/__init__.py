"""What was learned from rendered hands: where the detector errs, how much, and when it names the wrong side.

One small network (`network`), trained by scripts/train_landmarks.py on painted pictures of the open
hand only. docs/method.md tells on what, and what it is worth.
"""
