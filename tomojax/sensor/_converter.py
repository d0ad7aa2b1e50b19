"""Models what a measuring chain does to volts: noise, clipping, quantisation."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from tomojax._checks import checking, known, require
from tomojax._shown import named, shown

# A reading of the paper's converter, rms, of the drive: 0.3 mV of noise and zeros of as
# much at 4.5 V, 16 bits.
NOISE = 1e-4


class Converter(eqx.Module):
    """An analog input: white noise, then `bits` over ± `full_scale`, clipped.

    **Arguments:** `noise` V rms; `full_scale` V; `bits` of the converter, None for no
    quantisation. The gradient passes through as if nothing were rounded.

    **Example:**

    >>> import jax
    >>> import jax.numpy as jnp
    >>> import tomojax as tx
    >>> converter = tx.Converter(noise=0.0, full_scale=5.0, bits=12)
    >>> print(f"{float(converter(jnp.array(1.0))):.4f}")  # steps of 10 V/2¹²
    1.0010
    >>> noisy = tx.Converter(noise=1e-3)
    >>> noisy(jnp.ones(16), jax.random.key(0)).shape
    (16,)
    """

    noise: Float[Array, ""] = eqx.field(
        converter=checking("noise", "not negative", ()), default=0.3e-3
    )
    full_scale: Float[Array, ""] = eqx.field(
        converter=checking("full_scale", "positive", ()), default=5.0
    )
    bits: int | None = eqx.field(static=True, default=16)

    def __check_init__(self) -> None:
        whole = self.bits is None or (isinstance(self.bits, int) and 1 <= self.bits <= 32)
        require(whole, "bits", repr(self.bits), "a whole number from 1 to 32, or None")

    def __call__(
        self, volts: Float[Array, "*shape"], key: Array | None = None
    ) -> Float[Array, "*shape"]:
        """Reads `volts` as this converter does; `key` draws the noise."""
        silent = known(self.noise) and self.noise == 0
        require(silent or key is not None, "key", None, "a jax.random key for the noise")
        drawn = known(key) and not hasattr(key, "dtype")
        require(
            silent or not drawn, "key", repr(key), "a jax.random key, as jax.random.key(0)"
        )
        return _read(self, volts, None if silent else key)

    def __repr__(self) -> str:
        noise, full_scale = shown(self.noise, "V"), shown(self.full_scale, "V")
        return named(self, noise=noise, full_scale=full_scale, bits=shown(self.bits))


@eqx.filter_jit  # as one program to compile
def _read(
    converter: Converter, volts: Float[Array, "*shape"], key: Array | None
) -> Float[Array, "*shape"]:
    if key is not None:
        noise = converter.noise.astype(volts.dtype)
        volts = volts + noise * jax.random.normal(key, volts.shape, volts.dtype)
    if converter.bits is None:
        return volts
    half, full = 2 ** (converter.bits - 1), converter.full_scale.astype(volts.dtype)
    step = full / half
    codes = jnp.clip(jnp.round(volts / step), -half, half - 1)
    return volts + jax.lax.stop_gradient(codes * step - volts)
