"""Acquisition and reconstruction for a multi-modality inspector of plastic pipes."""
