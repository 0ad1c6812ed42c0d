"""Measurements and campaigns; `make bench` runs the short ones."""

import os

# Set before numpy is imported: arrays are small, and campaigns use the other cores by processes.
for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
