import copy

import pytest
import torch

from lfref.train.callbacks import HeadInitialization


@pytest.mark.filterwarnings("ignore:.*does not have many workers.*", "ignore:.*number of training batches.*")
def test_a_resumed_run_is_bit_equal_to_an_unbroken_one(module, data, trainer, tmp_path):
    broken = copy.deepcopy(module)
    trainer(max_epochs=4, callbacks=[HeadInitialization()]).fit(module, datamodule=data)
    first = trainer(max_epochs=2, callbacks=[HeadInitialization()])
    first.fit(broken, datamodule=data)
    first.save_checkpoint(tmp_path / "half.ckpt")
    second = trainer(max_epochs=4, callbacks=[HeadInitialization()])
    second.fit(broken, datamodule=data, ckpt_path=tmp_path / "half.ckpt", weights_only=True)
    for name, value in module.state_dict().items():
        assert torch.equal(value, broken.state_dict()[name]), name
