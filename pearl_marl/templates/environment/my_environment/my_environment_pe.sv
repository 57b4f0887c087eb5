// The core of MyEnvironment: step.py in hardware. Pipelined, a slot a cycle.
//
// The backbone takes the core's timing and the widths of its words from the package, and has one
// module for each processing element. The file is found by its name: that of its folder, and _pe.sv.
// The lint rule that a package has a file of its own name is off for it.

// verilator lint_off DECLFILENAME
package my_environment_pkg;
  // verilator lint_on DECLFILENAME

  // Cycles from an input to its result, and from one input to the next.
  localparam int unsigned LATENCY = 2;
  localparam int unsigned II = 1;

  // As in spec.py. Where they differ, elaboration stops and says so.
  localparam int unsigned STATE_BITS = 4;
  localparam int unsigned ACTION_BITS = 1;
  localparam int unsigned OBS_BITS = 4;
  localparam int unsigned REWARD_BITS = 2;

  // A state word, the first field of the spec last.
  typedef struct packed {logic [3:0] cell_number;} state_t;

endpackage

module my_environment_pe
  import my_environment_pkg::*;
#(
    // Of eight steps, how many the robot stays where it is: the option `slip`.
    parameter int SLIP = 1
) (
    input logic               clk_i,
    input logic               rst_ni,
    input logic               valid_i,
    // Start from the initial state, not from state_i.
    input logic               first_i,
    // Do not step: the result is the state started from and its observation.
    input logic               hold_i,
    input state_t             state_i,
    input logic               action_i,
    // The random draws of this slot and step, those for the initial state first.
    input logic   [1:0][31:0] rng_i,

    output logic         valid_o,
    output state_t       state_o,
    output logic   [3:0] obs_o,
    // 0 for a step, 1 for the goal, 2 for the pit.
    output logic   [1:0] reward_o,
    output logic         terminated_o
);

  localparam logic LEFT = 1'b0;
  localparam logic RIGHT = 1'b1;
  localparam logic [3:0] PIT = 4'd0;
  localparam logic [3:0] GOAL = 4'd15;
  localparam logic [3:0] FIRST_START = 4'd4;

  // First stage: where the slot starts from, and whether it moves. uniform_below(draw, 8) is the
  // upper half of a product with 8, which is the draw's upper three bits.
  state_t from_d, from_q;
  logic action_q, moves_d, moves_q, valid_q;
  logic unused_rng;

  assign from_d = first_i ? state_t'{cell_number: FIRST_START + {1'b0, rng_i[0][31:29]}} : state_i;
  assign moves_d = !hold_i & (int'(rng_i[1][31:29]) >= SLIP);
  assign unused_rng = ^{rng_i[0][28:0], rng_i[1][28:0]};

  always_ff @(posedge clk_i) begin
    from_q   <= from_d;
    action_q <= action_i;
    moves_q  <= moves_d;
  end

  // Second stage: the step.
  state_t state_d, state_q;
  logic left, right, goal_d, goal_q, pit_d, pit_q, valid_late_q;

  assign left = moves_q & (action_q == LEFT) & (from_q.cell_number != PIT);
  assign right = moves_q & (action_q == RIGHT) & (from_q.cell_number != GOAL);
  assign state_d.cell_number = from_q.cell_number + {3'b000, right} - {3'b000, left};
  assign goal_d = state_d.cell_number == GOAL;
  assign pit_d = state_d.cell_number == PIT;

  always_ff @(posedge clk_i) begin
    state_q <= state_d;
    goal_q  <= goal_d;
    pit_q   <= pit_d;
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
  assign obs_o = state_q.cell_number;
  assign reward_o = {pit_q, goal_q};
  assign terminated_o = goal_q | pit_q;

endmodule
