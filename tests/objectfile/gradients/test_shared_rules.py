"""What holds for all answers with gradients: derivatives, modes of torch, lists of tensors, sharing."""

import copy
import pickle

import numpy as np
import pytest
import torch
from refusals import refused
from scipy.sparse import csr_array

from objectfolder import ObjectFile
from objectfolder.base.checks import real_array
from objectfolder.base.errors import ObjectFolderError
from objectfolder.nets.hashgrid import WeightedRows
from objectfolder.touch.gradient import SoftGel
from objectfolder.touch.profiles import load_profile
from objectfolder.vision.radiosity import Bounced
from objectfolder.vision.surface_net import SurfaceNet

CAMERA, LIGHT = [[2.0, 1.0, 1.2]], [[0.5, 0.5, 0.7]]
FORCE = [[0.0, 0.0, 1.0]]


def answers(obj, points):
    """Functions of the name of a sense and an argument, which give a tensor."""
    modules = obj.torch()
    return {
        "sound": (lambda p: modules.sound(p, FORCE, duration=0.01), points),
        "touch": (lambda p: modules.touch(p).force, points),
        "depth": (lambda d: modules.touch(points, depth=d).force, torch.tensor(0.001)),
        "camera": (lambda c: modules.view(c, LIGHT, resolution=8).images, torch.tensor(CAMERA)),
        "light": (lambda l: modules.view(CAMERA, l, resolution=8).images, torch.tensor(LIGHT)),
    }


SENSES = ["sound", "touch", "depth", "camera", "light"]


@pytest.fixture(scope="module")
def bell():
    return ObjectFile.sample("bell")


@pytest.fixture(scope="module")
def points(bell):
    return torch.from_numpy(bell.sample_surface(1))


@pytest.mark.parametrize("sense", SENSES)
@pytest.mark.parametrize("power", [1, 2])
def test_a_second_derivative_raises(bell, points, sense, power):
    answer, value = answers(bell, points)[sense]
    total = lambda x: answer(x).pow(power).sum()  # noqa: E731
    value = value.clone().requires_grad_()
    (slope,) = torch.autograd.grad(total(value), value, create_graph=True)
    (plain,) = torch.autograd.grad(total(value), value)
    torch.testing.assert_close(slope.detach(), plain, rtol=1e-6, atol=0)
    refused("first derivatives only", torch.autograd.grad, slope.sum(), value, allow_unused=True)
    refused("first derivatives only", torch.autograd.functional.hessian, total, value.detach())


def applied(function, *others):
    """A custom Function of one tensor, and its first answer."""
    return lambda x: (lambda y: y[0] if isinstance(y, tuple) else y)(function.apply(x, *others))


def custom_functions():
    index = torch.arange(8, dtype=torch.int32)
    weights = torch.full((8,), 0.125)
    see, reflect = csr_array(np.eye(4, k=1, dtype=np.float32)), np.full((3, 4), 0.5, np.float32)
    height = torch.full((1, 160, 120), -1e-3)
    height[:, 70:90, 50:70] = 1e-3
    return {
        "rows": (applied(WeightedRows, index[None], weights[None]), torch.ones(8, 2)),
        "bounced": (applied(Bounced, see, reflect), torch.ones(4)),
        "gel": (applied(SoftGel, load_profile("digit")), height),
    }


@pytest.mark.parametrize("name", ["rows", "bounced", "gel"])
def test_derivatives_by_numpy_are_no_part_of_second_derivatives(name):
    function, value = custom_functions()[name]
    value.requires_grad_()
    (slope,) = torch.autograd.grad(function(value).square().sum(), value, create_graph=True)
    assert slope.any()
    with pytest.raises(RuntimeError, match="once_differentiable"):
        slope.sum().backward()


def test_sounds_have_second_derivatives_along_impulses(bell, points):
    sound = bell.torch(torch.float64).sound
    force = torch.tensor(FORCE, dtype=torch.float64)
    energy = lambda f: sound(points, f, duration=0.01).square().sum()  # noqa: E731
    curved = torch.autograd.functional.hessian(energy, force).reshape(3, 3)
    assert float(force[0] @ curved @ force[0] / 2) == pytest.approx(float(energy(force)))


def test_what_is_made_in_inference_mode_serves_gradients_later(bell, points):
    fresh = ObjectFile.sample("bell")
    with torch.inference_mode():
        for answer, value in answers(fresh, points).values():
            assert not answer(value).requires_grad
        fresh.view(CAMERA, LIGHT, resolution=8)
        fresh.touch(points)
        fresh.impact(points, FORCE, duration=0.01)
    for sense, (expected, value) in answers(bell, points).items():
        slopes = []
        for answer in (answers(fresh, points)[sense][0], expected):
            given = value.clone().requires_grad_()
            slopes += torch.autograd.grad(answer(given).sum(), given)
        assert torch.equal(*slopes), sense


def test_autocast_changes_no_answer(bell, points):
    def all_answers():
        yield from (answer(value) for answer, value in answers(bell, points).values())
        yield torch.from_numpy(bell.view(CAMERA, LIGHT, resolution=8))
        yield bell.impact(points, FORCE, duration=0.01)
        yield bell.touch(points)
        yield torch.from_numpy(bell.mode_shapes(points))
        yield torch.from_numpy(bell.base_colors(points.numpy() / bell.scale))
        yield from (torch.from_numpy(part.images) for part in bell.touches(points))

    usual = list(all_answers())
    with torch.autocast("cpu", torch.bfloat16):
        cast = list(all_answers())
        product = torch.ones(2, 2) @ torch.ones(2, 2)
        assert product.dtype == torch.bfloat16  # the caller's mode is as it was
    assert all(map(torch.equal, usual, cast))


def test_touches_leave_the_callers_modes_between_parts(bell, points):
    with torch.inference_mode():
        for _ in bell.touches(points):
            assert torch.is_inference_mode_enabled()


def test_transforms_of_torch_func_are_refused(points):
    fresh = ObjectFile.sample("bell")  # of which nothing has been read
    asked = list(answers(fresh, points).values())
    asked += [(fresh.touch, points), (lambda x: real_array("points", x), points)]
    for answer, value in asked:
        for transform in (torch.func.grad, torch.func.vmap):
            with pytest.raises(ObjectFolderError, match=r"torch\.func and vmap are not supported"):
                transform(lambda x, answer=answer: answer(x).sum())(value[None] if value.ndim == 0 else value)


@pytest.mark.filterwarnings("ignore")  # of the compiler, about itself
def test_a_compiled_module_answers_as_it_does_itself(bell, points):
    sound = bell.torch().sound
    compiled = torch.compile(sound, backend="eager")
    given = points.clone().requires_grad_()
    found = compiled(given, FORCE, duration=0.01)
    found.sum().backward()
    assert given.grad is not None
    assert torch.equal(found, sound(points, FORCE, duration=0.01))


def test_gradients_flow_to_tensors_in_lists(bell):
    modules, places = bell.torch(), bell.sample_surface(2)
    point, depth, push, x = (
        torch.tensor(value, dtype=torch.float64, requires_grad=True) for value in (places[0], 0.001, 1.0, 2.0)
    )
    felt = modules.touch([point, places[1]], depth=[depth, 0.002])
    assert torch.equal(felt.force, modules.touch(places, depth=[0.001, 0.002]).force)
    total = felt.force.sum() + modules.sound(places, [[push, 0.0, 0.0]], duration=0.01).sum()
    (total + modules.view([[x, 1, 1.2]], LIGHT, resolution=8).images.sum()).backward()
    assert all(tensor.grad.any() for tensor in (point, depth, push, x))
    refused("points is a list of tensors", modules.touch, [point, depth])


def test_queries_say_what_to_do_with_lists_of_tensors(bell, points):
    wanting = points[0].clone().requires_grad_()
    for given in ([wanting], [[wanting[0], 0.0, 0.0]]):
        refused(r"points is a list of tensors.*ObjectFile\.torch\(\)", bell.touch, given)


def test_modules_are_kept_and_left_out_of_copies(points):
    fresh = ObjectFile.sample("bell")
    modules = fresh.torch()
    assert modules is fresh.torch(torch.float32) is not fresh.torch(torch.float64)
    assert fresh.torch().touch is modules.touch
    for copied in (copy.deepcopy(fresh), pickle.loads(pickle.dumps(fresh))):
        assert copied.torch() is not modules
    for wrong in ([], torch.float16):
        refused("expected torch", fresh.torch, wrong)


def test_a_module_that_holds_one_does_not_cast_it(bell, points):
    sound = bell.torch().sound
    expected = sound(points, FORCE, duration=0.01)
    torch.nn.ModuleList([sound]).double()
    assert torch.equal(sound(points, FORCE, duration=0.01), expected)


def test_queries_and_gradients_share_what_is_baked(monkeypatch):
    baked, bake = [], SurfaceNet.bake
    monkeypatch.setattr(SurfaceNet, "bake", lambda net, surface: baked.append(net) or bake(net, surface))
    fresh = ObjectFile.sample("bell")
    fresh.view(CAMERA, LIGHT, resolution=8)
    for dtype in (torch.float32, torch.float64, torch.float32):
        fresh.torch(dtype).view(CAMERA, LIGHT, resolution=8)
    assert len(baked) == 1


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_no_views_have_the_type_of_views(bell, dtype):
    seen = bell.torch(dtype).view(np.zeros((0, 3)), LIGHT, resolution=8)
    assert seen.images.shape == seen.radiance.shape == (0, 8, 8, 3)
    assert seen.images.dtype == seen.radiance.dtype == dtype
    assert seen.inside.shape == (0, 8, 8)
