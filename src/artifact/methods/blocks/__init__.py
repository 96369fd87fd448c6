"""What the models are built of: backbones, attention, adapters, pooling, input checks."""
