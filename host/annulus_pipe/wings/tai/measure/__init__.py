"""Thermoacoustics as physics, no file and no instrument: codes, decoding filters, microwaves, sound, images, agreement.

`codes`, `search`, `templates`: what is sent and how it is compressed. `electromagnetics`, `confinement`: where power
stays and for how long. `field`: sound in a plane. `phantoms`: samples with known truth. `sweep`: one turn about a
sample, and its faults. `imaging`, `agreement`: from it to an image, a speed of sound, and the receivers to leave out.
"""
