"""Samples of robot images: crops, label maps, augmentation, batches."""
