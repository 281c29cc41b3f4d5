"""What measures beside the camera: samples of a head's sensors, the digitizer of the acoustic rig. Nothing here waits."""
