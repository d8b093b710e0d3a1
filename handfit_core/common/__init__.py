"""What every other room may use: arrays, files, untrusted input, errors, names of joints. It imports none of
them."""
