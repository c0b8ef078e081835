"""The network and everything else that ``model.safetensors`` holds."""
