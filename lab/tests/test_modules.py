"""Studies keep up with the names of the package."""

import importlib
import pkgutil

import pytest

import lab

MODULES = [one.name for one in pkgutil.walk_packages(lab.__path__, "lab.") if not one.name.startswith("lab.tests")]


@pytest.mark.parametrize("name", MODULES)
def test_a_study_can_be_imported(name):
    importlib.import_module(name)
