"""Two tests of the laboratory, with noise: what many tests of fits begin with."""

import copy

import pytest
from laboratory import fit_tables, write_tests


@pytest.fixture(scope="session")
def laboratory(tmp_path_factory):
    """Their folder, and their experiments as dicts."""
    folder = tmp_path_factory.mktemp("laboratory")
    return folder, write_tests(folder)


@pytest.fixture(scope="session")
def tables(laboratory):
    """Function that makes a fit file of them as a dict."""
    folder, written = laboratory
    return lambda **settings: fit_tables(folder, copy.deepcopy(written), **settings)


@pytest.fixture(scope="session")
def good(tables):
    """Their fit file as a dict."""
    return tables()
