// SPDX-License-Identifier: MIT
// A core that takes four cycles a slot: a multiplier that shifts and adds.

// verilator lint_off DECLFILENAME
package shift_add_pkg;
  // verilator lint_on DECLFILENAME

  localparam int unsigned LATENCY = 4;
  localparam int unsigned II = 4;

  localparam int unsigned STATE_BITS = 11;
  localparam int unsigned ACTION_BITS = 3;
  localparam int unsigned OBS_BITS = 13;
  localparam int unsigned REWARD_BITS = 5;

  typedef struct packed {
    logic [2:0] count;
    logic [7:0] value;
  } state_t;

endpackage

module shift_add_pe
  import shift_add_pkg::*;
#(
    parameter int unsigned NOISE = 15
) (
    input  logic                clk_i,
    input  logic                rst_ni,
    input  logic                valid_i,
    input  logic                first_i,
    input  logic                hold_i,
    input  state_t              state_i,
    input  logic   [ 2:0]       action_i,
    input  logic   [ 2:0][31:0] rng_i,
    output logic                valid_o,
    output state_t              state_o,
    output logic   [12:0]       obs_o,
    output logic   [ 4:0]       reward_o,
    output logic                terminated_o
);

  logic [LATENCY-1:0] valid_q;
  logic [2:0] action_q;
  logic [7:0] factor_q, sum_q;
  logic   [2:0] count_q;
  state_t       from;

  assign from = first_i ? state_t'{count: rng_i[1][31:29], value: rng_i[0][7:0]} : state_i;

  always_ff @(posedge clk_i) begin
    if (!rst_ni) valid_q <= '0;
    else valid_q <= {valid_q[LATENCY-2:0], valid_i};
  end

  always_ff @(posedge clk_i) begin
    if (valid_i) begin
      factor_q <= from.value;
      action_q <= hold_i ? '0 : action_i;
      sum_q    <= hold_i ? from.value : 8'(rng_i[2] & NOISE);
      count_q  <= hold_i ? from.count : from.count + 1'b1;
    end else begin
      // Nothing is added after the action's three bits have gone by.
      if (action_q[0]) sum_q <= sum_q + factor_q;
      factor_q <= factor_q << 1;
      action_q <= action_q >> 1;
    end
  end

  assign valid_o = valid_q[LATENCY-1];
  assign state_o = '{count: count_q, value: sum_q};
  assign obs_o = {1'b0, sum_q[7:4] ^ {1'b0, count_q}, sum_q};
  assign reward_o = sum_q[7:3];
  assign terminated_o = sum_q[2:0] == '0;

endmodule
