"""Names of the standard codes of `classification` in LAS files (LAS 1.4 R15, table 17)."""

CODE_NAMES = {
    **{0: "never classified", 1: "unclassified", 2: "ground", 3: "low vegetation", 4: "medium vegetation"},
    **{5: "high vegetation", 6: "building", 7: "low noise", 8: "model key point", 9: "water", 10: "rail"},
    **{11: "road surface", 13: "wire guard", 14: "wire conductor", 15: "transmission tower", 16: "wire connector"},
    **{17: "bridge deck", 18: "high noise"},
}
"""Code to name; codes from 64 are free for producers of data."""

NOISE_CODES = (7, 18)
"""Codes of noise."""
