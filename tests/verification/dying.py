"""Work that ends its own process, in a module that imports nothing of skystack."""

import os

from verification.inputs.isolation import Tally


def dies_at_3(share, folder, parent):
    for number in range(share.first, share.end):
        (folder / "a.json").write_text(str(number))
        parent.send((number, Tally(read=number - share.first)))
        if number == 3:
            os._exit(7)
    parent.send((None, Tally(read=share.end - share.first)))
