"""Train a small network of your own on the dataset's images: is there a robot, and where is its centre?

Rows without a robot have no cuboid; they train the first output alone.
"""

import io
import sys
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import torch
from PIL import Image
from torch import Tensor, nn
from torch.utils.data import DataLoader, Dataset

SIDE_PX = 96
CENTROID = 8  # the last of the nine points of projected_cuboid_px


class RobotImages(Dataset[tuple[Tensor, Tensor]]):
    """Images of one split, and the target (robot there, u, v) of each; u, v in image widths and heights."""

    def __init__(self, folder: Path, split: str) -> None:
        columns = ["image", "image_width_px", "image_height_px", "projected_cuboid_px"]
        files = sorted((folder / "poses").glob(f"{split}-*.parquet"))
        self.rows = [row for path in files for row in pq.read_table(path, columns=columns).to_pylist()]

    def __len__(self) -> int:
        return len(self.rows)

    def __getitem__(self, number: int) -> tuple[Tensor, Tensor]:
        row = self.rows[number]
        image = Image.open(io.BytesIO(row["image"]["bytes"])).convert("RGB").resize((SIDE_PX, SIDE_PX))
        pixels = torch.from_numpy(np.asarray(image, np.float32) / 255.0).permute(2, 0, 1)
        if row["projected_cuboid_px"] is None:
            return pixels, torch.zeros(3)
        u_px, v_px = row["projected_cuboid_px"][CENTROID]
        return pixels, torch.tensor([1.0, u_px / row["image_width_px"], v_px / row["image_height_px"]])


def network() -> nn.Module:
    """Four strided convolutions and a linear layer: (B, 3, SIDE_PX, SIDE_PX) -> (B, 3)."""
    layers: list[nn.Module] = []
    for channels_in, channels_out in ((3, 16), (16, 32), (32, 64), (64, 64)):
        layers += [nn.Conv2d(channels_in, channels_out, 3, stride=2, padding=1), nn.ReLU()]
    return nn.Sequential(*layers, nn.Flatten(), nn.Linear(64 * (SIDE_PX // 16) ** 2, 3))


def loss_of(output: Tensor, wanted: Tensor) -> Tensor:
    """Cross-entropy of "is there a robot", and the squared error of its centre where there is one."""
    there = wanted[:, 0]
    found = nn.functional.binary_cross_entropy_with_logits(output[:, 0], there)
    return found + (there[:, None] * (output[:, 1:] - wanted[:, 1:]) ** 2).sum(dim=1).mean()


def main(folder: Path, epochs: int) -> None:
    """Train, and print the loss on both splits after each epoch."""
    torch.manual_seed(0)
    model = network()
    optimiser = torch.optim.Adam(model.parameters(), lr=1e-3)
    loaders = {
        split: DataLoader(RobotImages(folder, split), batch_size=32, shuffle=split == "train")
        for split in ("train", "validation")
    }
    for epoch in range(epochs):
        losses: dict[str, list[float]] = {split: [] for split in loaders}
        for split, loader in loaders.items():
            for images, wanted in loader:
                with torch.set_grad_enabled(split == "train"):
                    loss = loss_of(model(images), wanted)
                if split == "train":
                    optimiser.zero_grad()
                    loss.backward()
                    optimiser.step()
                losses[split].append(loss.item())
        means = ", ".join(f"{split} {np.mean(found):.3f}" for split, found in losses.items())
        print(f"epoch {epoch}: {means}")


if __name__ == "__main__":
    main(
        Path(sys.argv[1] if len(sys.argv) > 1 else "data/dataset"),
        epochs=int(sys.argv[2]) if len(sys.argv) > 2 else 5,
    )
