// The core of CliffWalking: step.py in hardware. Pipelined, a slot a cycle.
//
// Of every environment the file <name>_pe.sv holds two things: this package, which tells the
// backbone the core's timing and the widths of its words, and the module.
// The lint rule that a package has a file of its own name is off for it.

// verilator lint_off DECLFILENAME
package cliff_walking_pkg;
  // verilator lint_on DECLFILENAME

  // Cycles from an input to its result, and from one input to the next.
  localparam int unsigned LATENCY = 2;
  localparam int unsigned II = 1;

  localparam int unsigned STATE_BITS = 6;
  localparam int unsigned ACTION_BITS = 2;
  localparam int unsigned OBS_BITS = 6;
  localparam int unsigned REWARD_BITS = 1;

  // A state word, the first field of the spec last.
  typedef struct packed {
    logic [3:0] column;
    logic [1:0] row;
  } state_t;

endpackage

module cliff_walking_pe
  import cliff_walking_pkg::*;
#(
    // Whether an action is turned left or right, with probability 1/3 each.
    parameter bit IS_SLIPPERY = 1'b0
) (
    input logic                           clk_i,
    input logic                           rst_ni,
    input logic                           valid_i,
    // Start from the initial state, not from state_i.
    input logic                           first_i,
    // Do not step: the result is the state started from and its observation.
    input logic                           hold_i,
    input state_t                         state_i,
    input logic   [ACTION_BITS-1:0]       action_i,
    // The random draws of this slot and step, those for the initial state first.
    input logic   [            0:0][31:0] rng_i,

    output logic                     valid_o,
    output state_t                   state_o,
    output logic   [   OBS_BITS-1:0] obs_o,
    // 0 for a step, 1 for a fall off the cliff.
    output logic   [REWARD_BITS-1:0] reward_o,
    output logic                     terminated_o
);

  localparam logic [ACTION_BITS-1:0] UP = 2'd0;
  localparam logic [ACTION_BITS-1:0] RIGHT = 2'd1;
  localparam logic [ACTION_BITS-1:0] DOWN = 2'd2;
  localparam logic [ACTION_BITS-1:0] LEFT = 2'd3;
  localparam logic [1:0] LAST_ROW = 2'd3;
  localparam logic [3:0] LAST_COLUMN = 4'd11;

  // First stage: where the slot starts from, and which way it goes.
  state_t from_d, from_q;
  logic [ACTION_BITS-1:0] action_d, action_q;
  logic hold_q, valid_q;

  assign from_d = first_i ? state_t'{row: LAST_ROW, column: '0} : state_i;

  if (IS_SLIPPERY) begin : gen_slippery
    // uniform_below(draw, 3): 0, 1, 2 stand for a turn of -1, 0, +1.
    logic [33:0] tripled;
    logic unused_tripled;
    assign tripled = {2'b00, rng_i[0]} + {1'b0, rng_i[0], 1'b0};
    assign unused_tripled = ^tripled[31:0];
    assign action_d = action_i + tripled[33:32] + 2'd3;
  end else begin : gen_dry
    logic unused_rng;
    assign unused_rng = ^rng_i;
    assign action_d   = action_i;
  end

  always_ff @(posedge clk_i) begin
    from_q   <= from_d;
    action_q <= action_d;
    hold_q   <= hold_i;
  end

  // Second stage: the step, in sums and masks as the golden step has it. A simulator then has no
  // branches to predict, which random actions would make it mispredict.
  state_t moved, state_d, state_q;
  logic moves, up, right, down, left;
  logic bottom, fell, goal;
  logic [OBS_BITS-1:0] obs_q;
  logic reward_q, terminated_q, valid_late_q;

  assign moves = !hold_q;
  assign up = moves & (action_q == UP) & (from_q.row != '0);
  assign right = moves & (action_q == RIGHT) & (from_q.column < LAST_COLUMN);
  assign down = moves & (action_q == DOWN) & (from_q.row != LAST_ROW);
  assign left = moves & (action_q == LEFT) & (from_q.column != '0);
  assign moved.row = from_q.row + {1'b0, down} - {1'b0, up};
  assign moved.column = from_q.column + {3'b000, right} - {3'b000, left};

  assign bottom = moves & (moved.row == LAST_ROW);
  assign goal = bottom & (moved.column == LAST_COLUMN);
  assign fell = bottom & (moved.column != '0) & (moved.column < LAST_COLUMN);
  assign state_d.row = moved.row;
  assign state_d.column = moved.column & ~{4{fell}};

  always_ff @(posedge clk_i) begin
    state_q <= state_d;
    // 12 * row + column
    obs_q <= {1'b0, state_d.row, 3'b000} + {2'b00, state_d.row, 2'b00} + {2'b00, state_d.column};
    reward_q <= fell;
    terminated_q <= goal;
  end

  // Only valid bits need a reset: what is not valid is not looked at.
  always_ff @(posedge clk_i or negedge rst_ni) begin
    if (!rst_ni) begin
      valid_q      <= 1'b0;
      valid_late_q <= 1'b0;
    end else begin
      valid_q      <= valid_i;
      valid_late_q <= valid_q;
    end
  end

  assign valid_o = valid_late_q;
  assign state_o = state_q;
  assign obs_o = obs_q;
  assign reward_o = reward_q;
  assign terminated_o = terminated_q;

endmodule
