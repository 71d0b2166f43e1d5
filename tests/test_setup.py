"""Set-up: uv gets the settings of pip."""

import importlib.util
import re

import pytest
from helpers.wiring import REPOSITORY


def installer():
    spec = importlib.util.spec_from_file_location("install_locked", REPOSITORY / "scripts" / "install_locked.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_uv_uses_the_indexes_folders_and_certificates_of_pip():
    listed = "\n".join(
        [
            ":env:.find-links='/wheels /more'",
            "global.find-links='/old'",
            "global.index-url='https://packages.example/simple'",
            "install.extra-index-url='file:///a\\nfile:///b'",
            "global.cert='/etc/ca.crt'",
            "global.timeout='60'",
        ]
    )
    given = installer().uv_environment(installer().pip_settings(listed))
    assert given["UV_FIND_LINKS"] == "/wheels,/more"
    assert given["UV_DEFAULT_INDEX"] == "https://packages.example/simple"
    assert given["UV_INDEX"] == "file:///a file:///b"
    assert given["SSL_CERT_FILE"] == "/etc/ca.crt"
    assert not any("timeout" in name.lower() for name in given)


def test_without_settings_uv_uses_its_own():
    assert not {"UV_DEFAULT_INDEX", "UV_INDEX", "UV_FIND_LINKS"} & set(installer().uv_environment({}))


@pytest.mark.parametrize(("lock", "least", "one"), [("requirements", 200, "uv"), ("requirements-label", 50, "numba")])
def test_all_locked_packages_have_hashes(lock, least, one):
    text = (REPOSITORY / f"{lock}.lock").read_text(encoding="utf-8")
    entry = r"^([\w.-]+)==\S+ (?:;[^\\]* )?\\\n(?:    --hash=sha256:[0-9a-f]{64}(?: \\)?\n)+"
    names = re.findall(entry, text, re.MULTILINE)
    assert len(names) == text.count("==") > least and one in names and "torch" not in names


def test_the_locked_torch_is_that_of_the_project():
    (pin,) = re.findall(r"^torch==\S+$", (REPOSITORY / "requirements-torch.lock").read_text(), re.MULTILINE)
    assert f'"{pin}"' in (REPOSITORY / "pyproject.toml").read_text()
