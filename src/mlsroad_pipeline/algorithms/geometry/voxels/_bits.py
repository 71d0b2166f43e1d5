"""Population count for compiled kernels, which Numba does not provide."""

from typing import Any

from numba import types
from numba.core.typing.templates import Signature
from numba.cpython.unsafe.numbers import trailing_zeros
from numba.extending import intrinsic

__all__ = ["popcount", "trailing_zeros"]


@intrinsic
def popcount(typing_context: Any, word: Any) -> tuple[Signature, Any]:
    """Count the set bits of a uint64; usable in compiled code only."""
    if word != types.uint64:
        return None  # type: ignore[return-value]  # rejects other types

    def generate(context: Any, builder: Any, signature: Signature, arguments: Any) -> Any:
        return builder.ctpop(arguments[0])

    return types.uint64(types.uint64), generate
