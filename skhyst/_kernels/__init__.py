"""Compiled array loops: no classes, no validation."""
