"""Builds the libraries in C, which pyproject.toml lists. None is a module of Python.

So their files have plain names, and one wheel of a platform serves every Python.
"""

from pathlib import Path
from shutil import rmtree

from setuptools import setup
from setuptools.command.bdist_wheel import bdist_wheel
from setuptools.command.build_ext import build_ext


class BuildLibraries(build_ext):
    """Builds libraries that ctypes and plugin hosts load."""

    def get_ext_filename(self, fullname: str) -> str:
        """Return the file of a library."""
        path = Path(super().get_ext_filename(fullname))
        return str(path.with_name(path.name.partition(".")[0] + ".so"))


class PlatformWheel(bdist_wheel):
    """A wheel of one platform, for every Python 3, without files of earlier builds."""

    def run(self) -> None:
        """Build it."""
        rmtree(self.get_finalized_command("build").build_lib, ignore_errors=True)
        super().run()

    def get_tag(self) -> tuple[str, str, str]:
        """Return the tags of Python, its binary interface and the platform."""
        return "py3", "none", super().get_tag()[2]


setup(cmdclass={"build_ext": BuildLibraries, "bdist_wheel": PlatformWheel})
