// SPDX-License-Identifier: MIT
// Runs a step from doorbell to done: waits for the random keys, starts the pipeline, counts cycles.
module pearl_sequencer (
    input  logic        clk_i,
    input  logic        rst_ni,
    // A doorbell was accepted.
    input  logic        ring_i,
    input  logic        keys_valid_i,
    // Every result word has been written.
    input  logic        results_done_i,
    output logic        busy_o,
    output logic        start_o,
    // In the last cycle in which busy_o is high.
    output logic        done_o,
    // Cycles from the doorbell to done_o, both included.
    output logic [31:0] cycles_o
);

  typedef enum logic [1:0] {
    Idle,
    WaitKeys,
    Running
  } state_e;

  state_e state_d, state_q;
  logic [31:0] cycles_q;

  always_comb begin
    state_d = state_q;
    start_o = 1'b0;
    done_o  = 1'b0;
    unique case (state_q)
      Idle: if (ring_i) state_d = WaitKeys;
      WaitKeys: begin
        start_o = keys_valid_i;
        if (keys_valid_i) state_d = Running;
      end
      Running: begin
        done_o = results_done_i;
        if (results_done_i) state_d = Idle;
      end
      default: state_d = Idle;
    endcase
  end

  always_ff @(posedge clk_i) begin
    if (!rst_ni) begin
      state_q  <= Idle;
      cycles_q <= '0;
    end else begin
      state_q  <= state_d;
      // The doorbell's cycle is the first, and the one after it is the second.
      cycles_q <= state_q == Idle ? 32'd2 : cycles_q + 1'b1;
    end
  end

  assign busy_o   = state_q != Idle;
  assign cycles_o = cycles_q;

  always_ff @(posedge clk_i) begin
    if (rst_ni) begin
      assert (!ring_i || state_q == Idle)
      else $error("pearl_sequencer: a doorbell rang during a step");
    end
  end

endmodule
