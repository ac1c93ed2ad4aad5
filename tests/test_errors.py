"""Messages that name what to install."""

from __future__ import annotations

import importlib.metadata
import pickle

import pytest

from mimic.errors import MissingExtra, install_line


def test_a_checkout_that_is_not_installed_is_named_itself(monkeypatch):
    def missing(name: str) -> list[str]:
        raise importlib.metadata.PackageNotFoundError(name)

    monkeypatch.setattr(importlib.metadata, "requires", missing)
    assert install_line("stock").startswith("pip install '/")
    assert install_line("stock").endswith("[stock]'")


@pytest.mark.parametrize(("extra", "package"), [("stock", "lcm"), ("env", "gymnasium")])
def test_the_packages_of_an_extra_are_named(monkeypatch, extra, package):
    lines = ["lcm<2,>=1.5.2; extra == 'stock'", "gymnasium<2,>=1.0; extra == 'env'", "numpy<3,>=2"]
    monkeypatch.setattr(importlib.metadata, "requires", lambda name: lines)
    assert install_line(extra).startswith(f"pip install '{package}<2")


def test_an_error_of_another_process_keeps_its_words():
    sent = MissingExtra("lcm", "robot")
    again = pickle.loads(pickle.dumps(sent))
    assert (type(again), str(again), again.extra) == (MissingExtra, str(sent), "robot")
