"""Optional dependencies: a missing one is an error of one line, and none is imported before it is needed."""

import subprocess
import sys

import pytest

from slam import extras
from slam.errors import MissingExtraError


@pytest.mark.parametrize(("extra", "package"), [("plots", "matplotlib"), ("batch", "dask"), ("web", "tornado")])
def test_missing_package_names_its_extra(monkeypatch: pytest.MonkeyPatch, extra: str, package: str) -> None:
    extras.require_extra(extra)
    monkeypatch.setattr(extras, "find_spec", lambda name: None)
    message = rf"^{package} is not installed; needs the extra '{extra}': pip install 'wclm-slam\[{extra}\]'$"
    with pytest.raises(MissingExtraError, match=message):
        extras.require_extra(extra)


def test_packages_of_extras_are_not_imported_by_the_modules_that_use_them() -> None:
    code = (
        "import sys; import slam.visualisation.plots, slam.offline.batch.cluster, slam.offline.batch.dispatch; "
        "print(sorted({'matplotlib', 'dask', 'distributed'} & set(sys.modules)))"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "[]"
