"""Builds the compiled parts; pyproject.toml lists them. The plugin's file gets a plain name."""

from pathlib import Path

from setuptools import setup
from setuptools.command.build_ext import build_ext

PLUGIN = "haptic_cushion"


class BuildExtensions(build_ext):
    """Builds extensions of Python, and the plugin, which is no module of Python."""

    def get_ext_filename(self, fullname: str) -> str:
        """Return the file of an extension: plugin hosts expect NAME.so."""
        found = super().get_ext_filename(fullname)
        path = Path(found)
        return str(path.with_name(f"{PLUGIN}.so")) if path.name.startswith(f"{PLUGIN}.") else found


setup(cmdclass={"build_ext": BuildExtensions})
