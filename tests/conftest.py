"""What all tests share."""

import pytest
from threadpoolctl import threadpool_limits


@pytest.fixture(scope="session", autouse=True)
def one_thread():
    """Small matrices: threads of the linear algebra would only wait for each other."""
    with threadpool_limits(limits=1, user_api="blas"):
        yield
