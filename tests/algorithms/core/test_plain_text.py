"""Text for terminals and logs."""

import pytest

from mlsroad_pipeline.algorithms.core.plain_text import printable, without_password


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("a\nb\r\nc", "a b c"),
        ("\x1b]0;title\x07\x1b[2Ja.laz", r"\x1b]0;title\x07\x1b[2Ja.laz"),
        ("Straße ß 街.laz", "Straße ß 街.laz"),
        ("\udce9.laz", r"\udce9.laz"),
        ("abc\u202e.zal", r"abc\u202e.zal"),
        ("\x9b31m", r"\x9b31m"),
    ],
)
def test_a_text_is_one_line_without_control_characters(text, shown):
    assert printable(text) == shown


@pytest.mark.parametrize(
    "text",
    [
        "mysql+pymysql://ann:{}@db:3306/x",
        "https://ann:{}@registry/api failed",
        "postgresql://u@h/x?password={}&sslmode=off",
        "token={}; retry",
        "Password: {}",
    ],
)
def test_secrets_are_stars(text):
    shown = without_password(text.format("pa/ss"))
    assert "pa/ss" not in shown and "***" in shown


def test_addresses_without_a_password_stay():
    for text in ("sqlite:////data/mlflow.db", "http://127.0.0.1:5000/#/runs", "s3://bucket/a@b:c"):
        assert without_password(text) == text
