/* $name as an S-function of Simulink: mex ${name}_sfun.c $name.c

   Input and output are those of ${name}_step, the second output is ${name}_status. A sample is taken
   when the step is final: within an algebraic loop, outputs are of trial inputs. */
#define S_FUNCTION_NAME ${name}_sfun
#define S_FUNCTION_LEVEL 2
#include "simstruc.h"

#include "$name.h"

#define WIDTH ((int_T)((sizeof(${name}_state) + sizeof(real_T) - 1u) / sizeof(real_T)))

enum { BEFORE, AFTER }; /* states before and after the sample */

static ${name}_state *state(SimStruct *S, int_T which)
{
    return (${name}_state *)ssGetDWork(S, which);
}

static void mdlInitializeSizes(SimStruct *S)
{
    int_T which;
    ssSetNumSFcnParams(S, 0);
    if (ssGetNumSFcnParams(S) != ssGetSFcnParamsCount(S)) {
        return; /* Simulink says what is wrong */
    }
    if (!ssSetNumInputPorts(S, 1) || !ssSetNumOutputPorts(S, 2)) {
        return;
    }
    ssSetInputPortWidth(S, 0, ${name}_N_INPUTS);
    ssSetInputPortDataType(S, 0, $simulink_type);
    ssSetInputPortRequiredContiguous(S, 0, 1);
    ssSetInputPortDirectFeedThrough(S, 0, 1);
    ssSetOutputPortWidth(S, 0, 1);
    ssSetOutputPortDataType(S, 0, $simulink_type);
    ssSetOutputPortWidth(S, 1, 1);
    ssSetOutputPortDataType(S, 1, SS_UINT32);
    ssSetNumDWork(S, 2);
    for (which = BEFORE; which <= AFTER; which++) {
        ssSetDWorkWidth(S, which, WIDTH);
        ssSetDWorkDataType(S, which, SS_DOUBLE);
    }
    ssSetNumSampleTimes(S, 1);
    ssSetOptions(S, SS_OPTION_EXCEPTION_FREE_CODE);
}

static void mdlInitializeSampleTimes(SimStruct *S)
{
    ssSetSampleTime(S, 0, ${name}_DT);
    ssSetOffsetTime(S, 0, 0.0);
}

#define MDL_INITIALIZE_CONDITIONS
static void mdlInitializeConditions(SimStruct *S)
{
    ${name}_init(state(S, BEFORE));
}

static void mdlOutputs(SimStruct *S, int_T tid)
{
    const $type *u = (const $type *)ssGetInputPortSignal(S, 0);
    (void)tid;
    *state(S, AFTER) = *state(S, BEFORE);
    *($type *)ssGetOutputPortSignal(S, 0) = ${name}_step(state(S, AFTER), u$one);
    *(uint32_T *)ssGetOutputPortSignal(S, 1) = ${name}_status(state(S, AFTER));
}

#define MDL_UPDATE
static void mdlUpdate(SimStruct *S, int_T tid)
{
    (void)tid;
    *state(S, BEFORE) = *state(S, AFTER);
}

static void mdlTerminate(SimStruct *S)
{
    (void)S;
}

#ifdef MATLAB_MEX_FILE
#include "simulink.c"
#else
#include "cg_sfun.h"
#endif
