"""From the profiles of many frames to the pipe: its wall, defects, stations and texture. Opens no file."""
