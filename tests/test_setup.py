"""Set-up: uv gets the settings of pip."""

import importlib.util

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


def test_the_lock_pins_uv_once():
    pins = (REPOSITORY / "requirements.lock").read_text().splitlines()
    assert len([line for line in pins if line.startswith("uv==")]) == 1
