"""The C file: CasADi's generated functions, and the loop around them."""

from pathlib import Path

import casadi
import numpy as np

from zoac.core.errors import ConfigError, suggest
from zoac.mpc.export.condensed import programme
from zoac.mpc.export.embedded import EmbeddedMpc, check_exportable
from zoac.mpc.export.interior_point import functions

ITERATIONS = 60
"""Limit a programme."""

SOLVED, ENOUGH = 1e-6, 1e-14
"""A programme is solved at the first residual; iterations end at the second, or when rounding lets
the residual grow again."""

TEMPLATE = """\
/* A model predictive controller: call mpc_init once, then mpc_step every sample.

   mpc_step reads observation[MPC_OBSERVATION] and writes action[MPC_INPUTS]. It returns 0, or 1
   where a quadratic programme was not solved; the action is then that of the last one of this step
   that was, else the inputs' reference, else 0, inside the bounds. No memory is allocated; the
   work space is static, so that one thread at a time may call mpc_step. */

/* Declarations for files that use it:
{declarations}
*/

{generated}
{declarations}

static const double mpc_rest[MPC_INPUTS] = {{{rest}}};
static const double mpc_before[MPC_INPUTS] = {{{before}}};
static const double mpc_low[MPC_INPUTS] = {{{low}}}, mpc_high[MPC_INPUTS] = {{{high}}};
static double mpc_hessian[{hessian}], mpc_gradient[{plan}], mpc_rows[{rows}];
static double mpc_limits[{m}], mpc_penalty[{m}], mpc_now[2][{state}], mpc_best[{plan}];
static double mpc_last[{plan}];
static double mpc_w[{w}];
static int mpc_iw[{iw}];

void mpc_init(mpc_state *s)
{{
    int i;
    for (i = 0; i < {plan}; i++) s->plan[i] = mpc_rest[i % MPC_INPUTS];
    for (i = 0; i < MPC_INPUTS; i++) s->input[i] = mpc_before[i];
}}

/* Solve the programme linearised about `plan`, and add the solution to it; return 1 if it fails. */
static int mpc_solve(const double *observation, const double *before, double *plan)
{{
    const double *arg[{arg}];
    double *res[{res}], scale, residual, best = HUGE_VAL;
    int i, k, now = 0;
    arg[0] = observation; arg[1] = before; arg[2] = plan;
    res[0] = mpc_hessian; res[1] = mpc_gradient; res[2] = mpc_rows; res[3] = mpc_limits;
    res[4] = mpc_penalty;
    if (mpc_programme(arg, res, mpc_iw, mpc_w, 0)) return 1;
    arg[0] = mpc_hessian; arg[1] = mpc_gradient; arg[2] = mpc_rows; arg[3] = mpc_limits;
    arg[4] = mpc_penalty;
    res[0] = mpc_now[now]; res[1] = &scale;
    if (mpc_begin(arg, res, mpc_iw, mpc_w, 0)) return 1;
    for (k = 0; k < {iterations}; k++) {{
        arg[0] = mpc_hessian; arg[1] = mpc_gradient; arg[2] = mpc_rows; arg[3] = mpc_limits;
        arg[4] = mpc_now[now]; arg[5] = &scale;
        res[0] = mpc_now[1 - now]; res[1] = &residual;
        if (mpc_iterate(arg, res, mpc_iw, mpc_w, 0)) return 1;
        if (!(residual < best)) {{
            if (!(best > {solved!r})) break;
            if (!(residual < HUGE_VAL)) return 1;
        }} else {{
            best = residual;
            for (i = 0; i < {plan}; i++) mpc_best[i] = mpc_now[now][i];
            if (best <= {enough!r}) break;
        }}
        now = 1 - now;
    }}
    if (!(best <= {solved!r})) return 1;
    for (i = 0; i < {plan}; i++) {{
        plan[i] += mpc_best[i];
        if (plan[i] < mpc_low[i % MPC_INPUTS]) plan[i] = mpc_low[i % MPC_INPUTS];
        if (plan[i] > mpc_high[i % MPC_INPUTS]) plan[i] = mpc_high[i % MPC_INPUTS];
    }}
    return 0;
}}

int mpc_step(mpc_state *s, const double *observation, double *action)
{{
    int i, k, failed = 0;
    for (i = 0; i < {plan}; i++) {{
{guess}
    }}
    for (k = 0; k < {linearisations} && !failed; k++) {{
        for (i = 0; i < {plan}; i++) mpc_last[i] = s->plan[i];
        failed = mpc_solve(observation, s->input, s->plan);
        if (failed && k == 0)
            for (i = 0; i < {plan}; i++) s->plan[i] = mpc_rest[i % MPC_INPUTS];
        if (!failed && k + 1 >= {undamped} && k + 1 < {linearisations})
            for (i = 0; i < {plan}; i++) s->plan[i] = 0.5 * (mpc_last[i] + s->plan[i]);
    }}
    for (i = 0; i < MPC_INPUTS; i++) action[i] = s->input[i] = s->plan[i];
    return failed;
}}
"""

DECLARATIONS = """\
enum {{ MPC_OBSERVATION = {observation}, MPC_INPUTS = {nu} }};
typedef struct {{ double plan[{plan}], input[{nu}]; }} mpc_state;
void mpc_init(mpc_state *s);
int mpc_step(mpc_state *s, const double *observation, double *action);"""

GUESS = {
    "zero": "        s->plan[i] = mpc_rest[i % MPC_INPUTS];",
    "shifted": "        if (i + MPC_INPUTS < {plan}) s->plan[i] = s->plan[i + MPC_INPUTS];",
}


def write_c(embedded: EmbeddedMpc, path: str | Path) -> Path:
    """Write an MPC as a C file; return the path.

    Raises:
        ConfigError: If the suffix is not `.c`, or the MPC does what the file cannot.
    """
    path = Path(path).expanduser()
    if path.suffix != ".c":
        raise ConfigError(f"export to {path.name!r}: {suggest(path.suffix, ['.c'])}")
    check_exportable(embedded)
    path.write_text(_code(embedded), encoding="utf-8")
    return path


def _code(embedded: EmbeddedMpc) -> str:
    problem, soft = programme(embedded)
    rest, horizon = embedded.objective.rest[0], embedded.options.horizon
    nu = len(rest)
    plan, m = nu * horizon, len(soft)
    parts = problem, *functions(problem.sparsity_out(2), soft)
    generated = casadi.CodeGenerator("mpc_casadi", {"casadi_int": "int"})
    for part in parts:
        generated.add(part)
    return TEMPLATE.format(
        declarations=DECLARATIONS.format(observation=embedded.observation, nu=nu, plan=plan),
        generated=generated.dump(),
        guess=GUESS[embedded.options.initial_guess].format(plan=plan),
        rest=_numbers(rest),
        before=_numbers(embedded.initial_input),
        low=_numbers(embedded.box[0]),
        high=_numbers(embedded.box[1]),
        hessian=plan * plan,
        plan=plan,
        rows=problem.nnz_out(2),
        m=m,
        state=plan + 4 * m,
        arg=max(part.sz_arg() for part in parts),
        res=max(part.sz_res() for part in parts),
        iw=max(1, *(part.sz_iw() for part in parts)),
        w=max(1, *(part.sz_w() for part in parts)),
        iterations=ITERATIONS,
        solved=SOLVED,
        enough=ENOUGH,
        linearisations=embedded.options.linearisations,
        undamped=embedded.undamped,
    )


def _numbers(values: np.ndarray) -> str:
    texts = (repr(float(value)) for value in values)
    return ", ".join({"inf": "HUGE_VAL", "-inf": "-HUGE_VAL"}.get(text, text) for text in texts)
