# The part of MuJoCo that this project uses; the wheel ships no types that a checker can follow. tests/test_stubs.py
# compares it with the library.
from collections.abc import Iterator, Sequence
from typing import overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

class _Array:
    # An array of the library's memory: read as an array, written from anything like one.
    def __get__(self, instance: object, owner: type | None = None) -> NDArray[np.float64]: ...
    def __set__(self, instance: object, value: ArrayLike) -> None: ...

class _Flag:
    # A switch that the library keeps as a number of its own.
    def __get__(self, instance: object, owner: type | None = None) -> int: ...
    def __set__(self, instance: object, value: bool | int) -> None: ...

class _Enum:
    value: int
    name: str
    def __int__(self) -> int: ...

class mjtBuiltin(_Enum):
    mjBUILTIN_FLAT: mjtBuiltin

class mjtCatBit(_Enum):
    mjCAT_ALL: mjtCatBit

class mjtCone(_Enum):
    mjCONE_ELLIPTIC: mjtCone

class mjtEq(_Enum):
    mjEQ_JOINT: mjtEq
    mjEQ_WELD: mjtEq

class mjtFont(_Enum):
    mjFONT_NORMAL: mjtFont

class mjtFontScale(_Enum):
    mjFONTSCALE_100: mjtFontScale

class mjtFramebuffer(_Enum):
    mjFB_OFFSCREEN: mjtFramebuffer

class mjtGeom(_Enum):
    mjGEOM_CYLINDER: mjtGeom
    mjGEOM_LINE: mjtGeom
    mjGEOM_MESH: mjtGeom
    mjGEOM_PLANE: mjtGeom

class mjtGridPos(_Enum):
    mjGRID_TOPLEFT: mjtGridPos

class mjtIntegrator(_Enum):
    mjINT_IMPLICITFAST: mjtIntegrator

class mjtJoint(_Enum):
    mjJNT_FREE: mjtJoint
    mjJNT_HINGE: mjtJoint
    mjJNT_SLIDE: mjtJoint

class mjtLightType(_Enum):
    mjLIGHT_DIRECTIONAL: mjtLightType

class mjtMeshInertia(_Enum):
    mjMESH_INERTIA_SHELL: mjtMeshInertia

class mjtObj(_Enum):
    mjOBJ_BODY: mjtObj
    mjOBJ_JOINT: mjtObj

class mjtTexture(_Enum):
    mjTEXTURE_SKYBOX: mjtTexture

class mjtTrn(_Enum):
    mjTRN_JOINT: mjtTrn

class MjOption:
    cone: int | mjtCone
    gravity = _Array()
    impratio: float
    integrator: int | mjtIntegrator
    timestep: float

class MjStatistic:
    center = _Array()
    extent: float

class MjVisual:
    class Global:
        fovy: float
        offheight: int
        offwidth: int

    class Headlight:
        ambient = _Array()
        diffuse = _Array()
        specular = _Array()

    class Map:
        fogend: float
        fogstart: float
        haze: float
        shadowclip: float
        zfar: float
        znear: float

    class Quality:
        offsamples: int
        shadowsize: int

    class Rgba:
        fog = _Array()
        haze = _Array()

    global_: Global
    headlight: Headlight
    map: Map
    quality: Quality
    rgba: Rgba

class MjsCompiler:
    fitaabb = _Flag()

class MjsGeom:
    conaffinity: int
    contype: int

class MjsJoint: ...
class MjsMesh: ...
class MjsTexture: ...
class MjsMaterial: ...

class MjsLight:
    type: mjtLightType

class MjsEquality:
    data = _Array()
    objtype: mjtObj
    solimp = _Array()
    solref = _Array()
    type: mjtEq

class MjsActuator:
    forcelimited = _Flag()
    forcerange = _Array()
    trntype: mjtTrn
    def set_to_position(self, kp: float, kv: float = ...) -> None: ...

class MjsBody:
    explicitinertial = _Flag()
    fullinertia = _Array()
    inertia = _Array()
    ipos = _Array()
    mass: float
    def add_body(
        self, *, name: str = ..., pos: ArrayLike = ..., quat: ArrayLike = ..., gravcomp: float = ..., mocap: bool = ...
    ) -> MjsBody: ...
    def add_freejoint(self, *, name: str = ...) -> MjsJoint: ...
    def add_geom(
        self,
        *,
        name: str = ...,
        type: mjtGeom = ...,
        meshname: str = ...,
        material: str = ...,
        pos: ArrayLike = ...,
        quat: ArrayLike = ...,
        size: ArrayLike = ...,
        rgba: ArrayLike = ...,
        friction: ArrayLike = ...,
        solref: ArrayLike = ...,
        mass: float = ...,
        condim: int = ...,
        contype: int = ...,
        conaffinity: int = ...,
    ) -> MjsGeom: ...
    def add_joint(
        self,
        *,
        name: str = ...,
        type: mjtJoint = ...,
        axis: ArrayLike = ...,
        range: ArrayLike = ...,
        limited: bool = ...,
        armature: float = ...,
        damping: ArrayLike = ...,
    ) -> MjsJoint: ...
    def add_light(
        self,
        *,
        pos: ArrayLike = ...,
        dir: ArrayLike = ...,
        castshadow: bool = ...,
        ambient: ArrayLike = ...,
        diffuse: ArrayLike = ...,
        specular: ArrayLike = ...,
    ) -> MjsLight: ...

class MjSpec:
    compiler: MjsCompiler
    option: MjOption
    stat: MjStatistic
    visual: MjVisual
    worldbody: MjsBody
    def __init__(self) -> None: ...
    def add_actuator(self, *, name: str = ..., target: str = ...) -> MjsActuator: ...
    def body(self, name: str, /) -> MjsBody: ...
    def geom(self, name: str, /) -> MjsGeom: ...
    def add_equality(
        self, *, name: str = ..., name1: str = ..., name2: str = ..., active: bool = ...
    ) -> MjsEquality: ...
    def add_material(self, *, name: str = ..., specular: float = ..., shininess: float = ...) -> MjsMaterial: ...
    def add_mesh(
        self,
        *,
        name: str = ...,
        uservert: ArrayLike = ...,
        userface: ArrayLike = ...,
        usernormal: ArrayLike = ...,
        userfacenormal: ArrayLike = ...,
        inertia: mjtMeshInertia = ...,
    ) -> MjsMesh: ...
    def add_texture(
        self,
        *,
        name: str = ...,
        type: mjtTexture = ...,
        builtin: mjtBuiltin = ...,
        rgb1: ArrayLike = ...,
        rgb2: ArrayLike = ...,
        width: int = ...,
        height: int = ...,
    ) -> MjsTexture: ...
    def compile(self) -> MjModel: ...

class _Named:
    # View of one element of a model, by its name.
    id: int
    name: str
    type: NDArray[np.int32]

class _PlacedBody:
    id: int
    name: str
    xpos: NDArray[np.float64]
    xquat: NDArray[np.float64]

class MjModel:
    actuator_biasprm: NDArray[np.float64]
    actuator_forcerange: NDArray[np.float64]
    actuator_gainprm: NDArray[np.float64]
    body_mass: NDArray[np.float64]
    eq_data: NDArray[np.float64]
    eq_obj1id: NDArray[np.int32]
    eq_obj2id: NDArray[np.int32]
    geom_bodyid: NDArray[np.int32]
    geom_dataid: NDArray[np.int32]
    geom_friction: NDArray[np.float64]
    geom_rgba: NDArray[np.float32]
    jnt_dofadr: NDArray[np.int32]
    jnt_qposadr: NDArray[np.int32]
    mesh_vert: NDArray[np.float32]
    mesh_vertadr: NDArray[np.int32]
    mesh_vertnum: NDArray[np.int32]
    nbody: int
    ngeom: int
    njnt: int
    nv: int
    opt: MjOption
    @staticmethod
    def from_xml_path(filename: str) -> MjModel: ...
    @staticmethod
    def from_xml_string(xml: str) -> MjModel: ...
    def body(self, name: str | int, /) -> _Named: ...
    def equality(self, name: str | int, /) -> _Named: ...
    def geom(self, name: str | int, /) -> _Named: ...
    def joint(self, name: str | int, /) -> _Named: ...

class MjContact:
    dist: float
    geom: NDArray[np.int32]

class _MjContactList:
    def __len__(self) -> int: ...
    def __iter__(self) -> Iterator[MjContact]: ...
    @overload
    def __getitem__(self, index: int, /) -> MjContact: ...
    @overload
    def __getitem__(self, index: slice, /) -> Sequence[MjContact]: ...

class MjData:
    contact: _MjContactList
    ctrl: NDArray[np.float64]
    eq_active: NDArray[np.uint8]
    geom_xmat: NDArray[np.float64]
    geom_xpos: NDArray[np.float64]
    mocap_pos: NDArray[np.float64]
    mocap_quat: NDArray[np.float64]
    ncon: int
    qfrc_applied: NDArray[np.float64]
    qpos: NDArray[np.float64]
    qvel: NDArray[np.float64]
    time: float
    xipos: NDArray[np.float64]
    xmat: NDArray[np.float64]
    xpos: NDArray[np.float64]
    xquat: NDArray[np.float64]
    def __init__(self, model: MjModel) -> None: ...
    def body(self, name: str | int, /) -> _PlacedBody: ...

class MjrContext:
    def __init__(self, model: MjModel, fontscale: int) -> None: ...
    def free(self) -> None: ...

class MjrRect:
    def __init__(self, left: int, bottom: int, width: int, height: int) -> None: ...

class MjvCamera:
    azimuth: float
    distance: float
    elevation: float
    lookat: NDArray[np.float64]
    def __init__(self) -> None: ...

class MjvGeom: ...

class MjvOption:
    def __init__(self) -> None: ...

class MjvPerturb: ...

class MjvScene:
    geoms: Sequence[MjvGeom]
    ngeom: int
    def __init__(self, model: MjModel, maxgeom: int) -> None: ...

def mj_camlight(m: MjModel, d: MjData) -> None: ...
def mj_contactForce(m: MjModel, d: MjData, id: int, result: NDArray[np.float64]) -> None: ...
def mj_forward(m: MjModel, d: MjData) -> None: ...
def mj_jac(
    m: MjModel,
    d: MjData,
    jacp: NDArray[np.float64] | None,
    jacr: NDArray[np.float64] | None,
    point: NDArray[np.float64],
    body: int,
) -> None: ...
def mj_kinematics(m: MjModel, d: MjData) -> None: ...
def mj_step(m: MjModel, d: MjData, nstep: int = ...) -> None: ...
def mjr_overlay(font: int, gridpos: int, viewport: MjrRect, overlay: str, overlay2: str, con: MjrContext) -> None: ...
def mjr_readPixels(
    rgb: NDArray[np.uint8] | None, depth: NDArray[np.float32] | None, viewport: MjrRect, con: MjrContext
) -> None: ...
def mjr_render(viewport: MjrRect, scn: MjvScene, con: MjrContext) -> None: ...
def mjr_setBuffer(framebuffer: int, con: MjrContext) -> None: ...
def mju_mat2Quat(quat: NDArray[np.float64], mat: NDArray[np.float64]) -> None: ...
def mjv_connector(
    geom: MjvGeom, type: mjtGeom, width: float, from_: NDArray[np.float64], to: NDArray[np.float64]
) -> None: ...
def mjv_initGeom(
    geom: MjvGeom,
    type: mjtGeom,
    size: NDArray[np.float64],
    pos: NDArray[np.float64],
    mat: NDArray[np.float64],
    rgba: NDArray[np.float32],
) -> None: ...
def mjv_updateScene(
    m: MjModel, d: MjData, opt: MjvOption, pert: MjvPerturb | None, cam: MjvCamera, catmask: int, scn: MjvScene
) -> None: ...
