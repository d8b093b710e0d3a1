"""What every other folder of handfit_core may use: arrays, files, untrusted input, errors, names of joints.
It imports none of those folders."""
