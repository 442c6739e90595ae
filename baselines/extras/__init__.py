"""Tuners of libraries that zoac does not install: each is an extra, such as zoac[botorch]."""
