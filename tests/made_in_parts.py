"""A method with both outputs, and processes that make its parts: what the tests of parts end at random moments."""

import os
import threading
import time
from pathlib import Path

import torch
from torch.nn import functional
from tqdm import tqdm

from artifact import datasets, manifest
from artifact.extraction import extract, jobs, parts

BATCH_SECONDS = 0.002


class Both(torch.nn.Module):
    """Descriptors and hash codes that depend on the images that share a batch."""

    def descriptors_and_codes(self, images):
        time.sleep(BATCH_SECONDS)
        pixels = images.flatten(1)
        apart = functional.normalize(pixels[:, :108] - 0.9 * pixels[:, :108].mean(dim=0), dim=-1)
        return apart, torch.where(pixels[:, 200:216] > pixels.mean(dim=0)[200:216], 1, -1).to(torch.int8)


def write(project, **changes):
    """Add the method to the project's manifest."""
    from conftest import HOG, tiny_manifest, write_manifest  # takes long to import, and the processes do without

    own = {"title": "Both", "builder": f"{__name__}:Both", "code_bits": 16, "rerank": 2, "batch_size": 4}
    content = tiny_manifest()
    content["methods"]["both"] = HOG | own | {"batch_dependent": True} | changes
    write_manifest(project, content)
    return load(project)


def load(project):
    loaded = manifest.load(Path(project) / "data_manifest.yaml")
    return loaded, datasets.load_traversal(loaded, "street", "day")


def _begin(batches_each):
    os.environ.pop("ARTIFACT_CACHE", None)
    tqdm.set_lock(threading.RLock())  # its own lock is shared between processes, and remains of a killed one
    torch.set_num_threads(1)
    parts._BATCHES = batches_each


def all_of_it(project, batches_each):
    """For a process of its own: make descriptors and codes, in small parts."""
    _begin(batches_each)
    loaded, traversal = load(project)
    extract.descriptors(loaded, traversal, "both", workers=0)
    extract.second_stage(loaded, traversal, "both", workers=0)


def all_jobs(project, batches_each, barrier):
    """For a process of its own: run all jobs at the same time as others, one by one."""
    _begin(batches_each)
    loaded, traversal = load(project)
    todo = jobs.jobs_of(loaded, traversal, "both")
    forward = jobs.forward_of(todo[0], "cpu")
    barrier.wait()
    for job in todo:
        jobs.run([job], forward, workers=0)
