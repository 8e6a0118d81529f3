"""Which object is it? From a view, a sound, a touch, and all of their combinations (supplementary I.1)."""

import copy
import shutil
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import astuple, dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn

from objectfolder.artifacts import MODALITIES, read_json, write_json
from objectfolder.benchmarks.encoders import InputSizes, Weights, make_encoder, prepare
from objectfolder.benchmarks.observations import Observations
from objectfolder.benchmarks.scores import accuracy, interval_95
from objectfolder.benchmarks.splits import Split, without_duplicates
from objectfolder.benchmarks.training import EpochPoint, shuffled, train
from objectfolder.params import RecognizeParams
from objectfolder.seeding import numpy_generator, seeded

FUSION_RATE = 0.1  #: learning rate of a fusion, whose encoders are trained already, relative to the first
CURVE_COLUMNS = ("seed", "modalities", "epoch", "train_loss", "val_accuracy")

Inputs = dict[str, torch.Tensor]
