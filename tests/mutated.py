"""One module with another text, in a process and in those that it starts: what :mod:`mutants` tries tests on."""

import importlib.util
import os
import sys

_VARIABLE = "MUTATED_MODULE"


class Finder:
    """Finds one module in a file of its own; a package keeps its folder."""

    def __init__(self, name, file, folder):
        self.name, self.file, self.folders = name, file, [folder] if folder else None

    def find_spec(self, name, path=None, target=None):
        if name != self.name:
            return None
        return importlib.util.spec_from_file_location(name, self.file, submodule_search_locations=self.folders)


def install(*which):
    """Find the module there from now on, and in every process that is started from here with this folder on its path."""
    os.environ[_VARIABLE] = os.pathsep.join(which)
    sys.meta_path.insert(0, Finder(*which))


def install_as_in_parent():
    if _VARIABLE in os.environ:
        install(*os.environ[_VARIABLE].split(os.pathsep))
