"""Measurements and campaigns; `make bench` runs the short ones."""

import os

# Before numpy is imported: the arrays are small, times are those of one core, and processes fill the others.
for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")
