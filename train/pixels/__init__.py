"""Camera-based rendezvous: MuJoCo renders images, a detector extracts bearings for a policy."""
