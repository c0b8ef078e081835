"""The fast trainer: the loss, optimiser, data order and checkpoints of ``lerobot-train``, windows in memory."""
