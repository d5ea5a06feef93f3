"""Learning: targets, losses, augmentation, pre-training and fine-tuning."""
