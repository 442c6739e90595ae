"""Tuners of other libraries, each with an extra of its own: `pip install 'zoac[botorch]'`."""
