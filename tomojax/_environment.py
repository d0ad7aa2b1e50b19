"""Names the device, the machine and the versions that made a result."""

import platform
from importlib.metadata import version


def environment() -> dict[str, str]:
    """Returns device, machine and versions, for the JSON files."""
    import jax  # half a second, which a command that writes no JSON need not spend

    packages = ("tomojax", "jax", "jaxlib", "equinox", "numpy")
    return {
        "device": str(jax.devices()[0].device_kind),
        "machine": platform.machine(),
        "python": platform.python_version(),
        **{name: version(name) for name in packages},
    }
