"""Random numbers are those of JAX, and their generator is compiled without loops."""

import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from skystack.compilation.random_bits import threefry

ONES = 0xFFFFFFFF
DRAWS = """
import jax
key = jax.random.key(2**31 + 5)
print([int(bits) for bits in jax.random.bits(key, (7,))])
print([int(bits) for bits in jax.random.key_data(jax.random.split(key, 3)).ravel()])
print([int(index) for index in jax.random.permutation(jax.random.fold_in(key, 9), 11)])
"""


@pytest.mark.parametrize(
    ("key", "counter", "expected"),
    [
        ((0, 0), (0, 0), (0x6B200159, 0x99BA4EFE)),
        ((ONES, ONES), (ONES, ONES), (0x1CB996FC, 0xBB002BE7)),
        ((0x13198A2E, 0x03707344), (0x243F6A88, 0x85A308D3), (0xC4923A9C, 0x483DF7A0)),
    ],
)
def test_gives_the_known_answers(key, counter, expected):
    """Those of the authors' library, Random123."""
    words = [jnp.uint32(word) for word in (*key, *counter)]
    assert tuple(int(word) for word in jax.jit(threefry)(*words)) == expected


@pytest.mark.slow
def test_draws_what_jax_alone_draws(capsys):
    found = subprocess.run(
        [sys.executable, "-c", DRAWS], check=True, capture_output=True, text=True
    )
    jax.clear_caches()
    exec(DRAWS, {})
    assert capsys.readouterr().out == found.stdout


def test_compiles_without_loops():
    keys = jax.random.split(jax.random.key(0), 4)
    draw = jax.jit(jax.vmap(lambda key: jax.random.uniform(key, (3,))))
    assert "while" not in draw.lower(keys).as_text()
    assert np.all(draw(keys) < 1.0)
