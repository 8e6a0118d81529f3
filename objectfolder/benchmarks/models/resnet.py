"""ResNet-18 (He et al. 2016) without its last layer; parameters are named as in torchvision's files."""

import torch
from torch import nn

FEATURES = 512  #: numbers of a feature vector, at full width


class Block(nn.Module):
    """Two 3x3 convolutions around which the input is passed on (the paper's "basic block")."""

    def __init__(self, inputs: int, outputs: int, stride: int):
        super().__init__()
        self.conv1 = nn.Conv2d(inputs, outputs, 3, stride, 1, bias=False)
        self.bn1 = nn.BatchNorm2d(outputs)
        self.conv2 = nn.Conv2d(outputs, outputs, 3, 1, 1, bias=False)
        self.bn2 = nn.BatchNorm2d(outputs)
        self.downsample = None
        if stride != 1 or inputs != outputs:
            self.downsample = nn.Sequential(
                nn.Conv2d(inputs, outputs, 1, stride, bias=False), nn.BatchNorm2d(outputs)
            )

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """(B, inputs, H, W) -> (B, outputs, H / stride, W / stride)."""
        shortcut = x if self.downsample is None else self.downsample(x)
        x = torch.relu(self.bn1(self.conv1(x)))
        return torch.relu(self.bn2(self.conv2(x)) + shortcut)


class ResNet18(nn.Module):
    """Residual network of 18 layers, up to and with its average pooling.

    Convolutions start from Kaiming's normal distribution (fan out), drawn from torch's global generator: make
    it within `objectfolder.base.seeding.seeded`. ``width`` is a factor of the number of channels of every
    layer, and hence of ``features``.
    """

    def __init__(self, channels: int = 3, width: float = 1.0):
        super().__init__()
        self.features = round(FEATURES * width)
        a, b, c, d = (self.features // part for part in (8, 4, 2, 1))
        self.conv1 = nn.Conv2d(channels, a, 7, 2, 3, bias=False)
        self.bn1 = nn.BatchNorm2d(a)
        self.maxpool = nn.MaxPool2d(3, 2, 1)
        self.layer1 = nn.Sequential(Block(a, a, 1), Block(a, a, 1))
        self.layer2 = nn.Sequential(Block(a, b, 2), Block(b, b, 1))
        self.layer3 = nn.Sequential(Block(b, c, 2), Block(c, c, 1))
        self.layer4 = nn.Sequential(Block(c, d, 2), Block(d, d, 1))
        for module in self.modules():
            if isinstance(module, nn.Conv2d):
                nn.init.kaiming_normal_(module.weight, mode="fan_out", nonlinearity="relu")

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """(B, channels, H, W) -> (B, features)."""
        x = self.maxpool(torch.relu(self.bn1(self.conv1(x))))
        x = self.layer4(self.layer3(self.layer2(self.layer1(x))))
        return x.mean((2, 3))
