"""The thermoacoustic rig: the controller's pins heat a phantom, turn it and trigger a scope that speaks SCPI.

    rig = AcousticRig(open_board("native"), Receiver(RigSetup(phantom("wires"))))
    with serving(rig):                                   # real time, on a thread of its own
        client, scope = Client(rig.port_url), ScopeDigitizer(rig.scope_name)

`phantom` works out once what an instant of heat sounds like all round, `receiver` makes volts of it for whatever the
pins did, `scope` digitizes and answers, `rig` puts them on a board.

Differs from a real rig: a plane, not a room; no reverberation; the receiver's face is a point; the scope is armed the
moment it is told; a scope that waits for a trigger gives up when its connection is lost.
"""
