"""Builds the C libraries that pyproject.toml lists. None of them is a Python extension module.

Their file names thus contain no Python version, and one wheel per platform serves every Python 3.
"""

from pathlib import Path
from shutil import rmtree

from setuptools import setup
from setuptools.command.bdist_wheel import bdist_wheel
from setuptools.command.build_ext import build_ext


class BuildLibraries(build_ext):
    """Builds libraries that ctypes and plugin hosts load."""

    def get_ext_filename(self, fullname: str) -> str:
        """Return the path of a library's file, without a Python version in its name."""
        path = Path(super().get_ext_filename(fullname))
        return str(path.with_name(path.name.partition(".")[0] + ".so"))


class PlatformWheel(bdist_wheel):
    """A wheel of one platform, for every Python 3, without files of earlier builds."""

    def run(self) -> None:
        """Build the wheel."""
        rmtree(self.get_finalized_command("build").build_lib, ignore_errors=True)
        super().run()

    def get_tag(self) -> tuple[str, str, str]:
        """Return the wheel's tags for the Python version, the Python ABI and the platform."""
        return "py3", "none", super().get_tag()[2]


setup(cmdclass={"build_ext": BuildLibraries, "bdist_wheel": PlatformWheel})
