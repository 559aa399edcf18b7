"""MCAP files: chunks of messages, or messages alone."""

from __future__ import annotations

from typing import BinaryIO

from formats.logs.block_files import BlockFile, DamagedBlockError
from formats.logs.channels import Block, Found, Index
from formats.logs.files import begins_about_as
from formats.logs.mcap_records import MAGIC, Definitions, block_messages
from formats.logs.mcap_scan import McapScan
from mapmyworld.errors import LogError


class McapFile(BlockFile):
    """An MCAP file; raises `LogError` where it is none."""

    def _scan(self, source: BinaryIO) -> Index:
        if not begins_about_as(source.read(len(MAGIC)), MAGIC):
            raise LogError(f"{self.path}: not an MCAP file: its first bytes are not MCAP's")
        return McapScan(source, self.path).run()

    def _messages(self, source: BinaryIO, block: Block) -> list[Found]:
        source.seek(block.offset)
        data = source.read(block.length)
        if len(data) < block.length:
            raise DamagedBlockError("it is shorter")
        return block_messages(data, Definitions())
