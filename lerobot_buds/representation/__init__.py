"""The multi-sensory representation: one latent per frame from all cameras and proprioception."""
