"""Figures are drawn to memory and closed after each test."""

import matplotlib
import pytest

matplotlib.use("Agg")


@pytest.fixture(autouse=True)
def close_figures():
    from matplotlib import pyplot

    pyplot.close("all")  # those of whatever ran before in this process
    yield
    pyplot.close("all")
